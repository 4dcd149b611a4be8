# Grains beside SPH particles at the same times, same colours, same scale, into a PNG, with ParaView (packages paraview,
# python3-paraview). FOLDERs are those of `dem2sph dem` (a seed's) and `dem2sph flow`, as `compare` leaves them.
#   pvpython cases/render_pair.py GRAINS_FOLDER SPH_FOLDER PICTURE.png [--frames 0 4 24] [--size 1500 700]
#   pvpython cases/render_pair.py GRAINS_FOLDER SPH_FOLDER FILM.webm --film      (with ffmpeg)
# On a machine without a screen: xvfb-run -a pvpython ... (packages xvfb, xauth, libgl1-mesa-dri).
import argparse
import os
import shutil
import subprocess
import sys
import tempfile

from paraview.simple import (
    Calculator,
    ColorBy,
    Delete,
    Render,
    SaveScreenshot,
    Show,
    Threshold,
    Transform,
    XMLPolyDataReader,
)

from rendering import colour_by, look_at, series, text, white_view

parser = argparse.ArgumentParser()
parser.add_argument("grains")
parser.add_argument("sph")
parser.add_argument("picture")
parser.add_argument("--frames", type=int, nargs="+", help="numbers of SPH frames; default: first, a sixth, last")
parser.add_argument("--size", type=int, nargs=2, default=[1500, 700])
parser.add_argument("--film", action="store_true", help="every frame, as a film")
options = parser.parse_args()


grains, sph = series(options.grains), series(options.sph)
chosen = list(range(len(sph))) if options.film else options.frames or [0, len(sph) // 6, len(sph) - 1]
if max(chosen) >= len(sph):
    sys.exit(f"there are SPH frames 0 to {len(sph) - 1}")


def bounds_of(path):
    reader = XMLPolyDataReader(FileName=[path])
    reader.UpdatePipeline()
    bounds = reader.GetDataInformation().GetBounds()
    Delete(reader)
    return bounds


first, last = bounds_of(sph[0][1]), bounds_of(grains[-1][1])
left, right = min(last[0], 0.0), 1.03 * last[1]
low, high = min(0.0, last[4]), first[3]
width, height = right - left, 1.15 * (high - low)

view = white_view(options.size)


def speeds(path, up_is_z, column, row, size, fastest):
    """Shows one frame and returns what was made, and its largest speed."""
    reader = XMLPolyDataReader(FileName=[path])
    inside = Threshold(Input=reader, Scalars=["POINTS", "kind"], LowerThreshold=0, UpperThreshold=0)
    source = Calculator(Input=inside, Function="mag(v)", ResultArrayName="speed")
    moved = Transform(Input=source)
    moved.Transform = "Transform"
    moved.Transform.Rotate = [-90 if up_is_z else 0, 0, 0]
    moved.Transform.Translate = [1.08 * width * column, -height * row, 0]
    moved.UpdatePipeline()
    drawn = Show(moved, view)
    drawn.SetRepresentationType("Point Gaussian")
    drawn.GaussianRadius = size
    drawn.ShaderPreset = "Plain circle"
    ColorBy(drawn, ("POINTS", "speed"))
    return [drawn, moved, source, inside, reader], max(fastest, moved.PointData["speed"].GetRange()[1])


def label(content, x, y, centre, half):
    """A text whose lower left corner is at x, y of the scene."""
    shown = text(view, content, 16)
    shown.Position = [0.5 + 0.5 * (x - centre[0]) / (half * options.size[0] / options.size[1]),
                      0.5 + 0.5 * (y - centre[1]) / half]
    return shown


def radius_of(path, name):
    reader = XMLPolyDataReader(FileName=[path])
    reader.UpdatePipeline()
    value = reader.PointData[name].GetRange()[0] if reader.PointData.GetArray(name) else None
    Delete(reader)
    return value


grain = 1.2 * (radius_of(grains[0][1], "radius") or 0)


def draw(numbers, picture, scale_to=None):
    made, fastest = [], 0.0
    rows = len(numbers)
    centre = (left + 1.04 * width, 0.5 * (high + low - height * (rows - 1)) + 0.05 * height)
    half = max(0.52 * 2.08 * width * options.size[1] / options.size[0], 0.5 * (height * rows + 0.12 * height))
    for row, number in enumerate(numbers):
        time = sph[number][0]
        nearest = min(grains, key=lambda entry: abs(entry[0] - time))
        for column, path in ((0, nearest[1]), (1, sph[number][1])):
            # SPH particles a little larger, so that their lattice has no gaps.
            parts, fastest = speeds(path, column == 0, column, row, (1 + 0.35 * column) * grain, fastest)
            made += parts
        for column in (0, 1):
            top = high - height * row + 0.02 * height
            name = ("grains (LIGGGHTS), " if column == 0 else "SPH, ") if row == 0 else ""
            made.append(label(f"{name}t = {time:.3f} s", left + 1.08 * width * column, top, centre, half))
    colour_by(view, "speed", "speed [m/s]", 0, scale_to or fastest, [0.68, 0.86], 0.25)
    made[0].SetScalarBarVisibility(view, True)
    Render(view)
    look_at(view, centre, half)
    Render(view)
    SaveScreenshot(picture, view, ImageResolution=options.size)
    for part in made:
        Delete(part)
    return fastest


if not options.film:
    draw(chosen, options.picture)
else:
    if shutil.which("ffmpeg") is None:
        sys.exit("a film needs ffmpeg: install it with apt-get install ffmpeg")
    with tempfile.TemporaryDirectory() as folder:
        fastest = max(draw([n], os.path.join(folder, "test.png")) for n in chosen[:: max(1, len(chosen) // 8)])
        for k, n in enumerate(chosen):
            draw([n], os.path.join(folder, f"{k:05}.png"), fastest)
        subprocess.run(["ffmpeg", "-y", "-loglevel", "error", "-framerate", "8", "-i", os.path.join(folder, "%05d.png"),
                        "-pix_fmt", "yuv420p", options.picture], check=True)
