# Draws frames of a flow, one above the other, into a PNG, with ParaView (packages paraview, python3-paraview).
#   pvpython cases/render.py FLOW_FOLDER PICTURE.png [--field v] [--frames 0 6 24] [--size 1100 760]
# On a machine without a screen: xvfb-run -a pvpython ... (packages xvfb, xauth, libgl1-mesa-dri).
import argparse
import os
import sys

from paraview.simple import (
    Calculator,
    ColorBy,
    Render,
    SaveScreenshot,
    Show,
    Threshold,
    Transform,
    XMLPolyDataReader,
)

from rendering import colour_by, look_at, series, text, white_view

parser = argparse.ArgumentParser()
parser.add_argument("folder")
parser.add_argument("picture")
parser.add_argument("--field", default="v", help="v (its magnitude), p, mu, phi, beta, gamma_dot")
parser.add_argument("--frames", type=int, nargs="+", help="numbers of frames; default: first, a quarter, last")
parser.add_argument("--size", type=int, nargs=2, default=[1100, 760])
options = parser.parse_args()

frames = series(options.folder)
chosen = options.frames or [0, len(frames) // 4, len(frames) - 1]
for number in chosen:
    if number >= len(frames):
        sys.exit(f"there are frames 0 to {len(frames) - 1}, not {number}")

units = {"v": "speed [m/s]", "p": "pressure [Pa]", "mu": "friction", "phi": "solid fraction",
         "beta": "dilation rate", "gamma_dot": "shear rate [1/s]"}
view = white_view(options.size)

readers = [XMLPolyDataReader(FileName=[frames[n][1]]) for n in chosen]
for reader in readers:
    reader.UpdatePipeline()
bounds = readers[0].GetDataInformation().GetBounds()
height = bounds[3] - bounds[2]
lowest, highest = 1e300, -1e300
shown = []
labels = []
for row, (number, reader) in enumerate(zip(chosen, readers)):
    moved = Transform(Input=reader)
    moved.Transform = "Transform"
    moved.Transform.Translate = [0, -1.12 * height * row, 0]
    inside = Threshold(Input=moved, Scalars=["POINTS", "kind"], LowerThreshold=0, UpperThreshold=0)
    walls = Threshold(Input=moved, Scalars=["POINTS", "kind"], LowerThreshold=1, UpperThreshold=1)
    grey = Show(walls, view)
    grey.SetRepresentationType("Points")
    grey.PointSize = 3
    grey.ColorArrayName = [None, ""]
    grey.DiffuseColor = grey.AmbientColor = [0.75, 0.75, 0.75]
    source = inside
    if options.field == "v":
        source = Calculator(Input=inside, Function="mag(v)", ResultArrayName="speed")
    array = "speed" if options.field == "v" else options.field
    source.UpdatePipeline()
    span = source.PointData[array].GetRange()
    lowest, highest = min(lowest, span[0]), max(highest, span[1])
    drawn = Show(source, view)
    drawn.SetRepresentationType("Points")
    drawn.PointSize = 5
    ColorBy(drawn, ("POINTS", array))
    shown.append(drawn)
    label = text(view, f"t = {frames[number][0]:.3f} s", 18)
    labels.append(label)

colour_by(view, array, units.get(options.field, options.field), lowest, highest, [0.62, 0.88], 0.3)
shown[-1].SetScalarBarVisibility(view, True)

# Look at all rows. The first rendering sets the camera by itself, so ours comes after it.
Render(view)
right = max(reader.GetDataInformation().GetBounds()[1] for reader in readers)
pitch = 1.12 * height
centre_x = 0.5 * (bounds[0] + right)
centre_y = 0.5 * (bounds[3] + bounds[2] - pitch * (len(chosen) - 1))
aspect = options.size[0] / options.size[1]
half = 0.52 * max(height + pitch * (len(chosen) - 1), (right - bounds[0]) / aspect)
look_at(view, (centre_x, centre_y), half)
for row, label in enumerate(labels):
    middle = 0.5 * (bounds[2] + bounds[3]) - pitch * row
    label.Position = [0.62, 0.5 + 0.5 * (middle - centre_y) / half]
Render(view)
SaveScreenshot(options.picture, view, ImageResolution=options.size)
