# Draws frames of a flow, one above the other, into a PNG, with ParaView (packages paraview, python3-paraview).
#   pvpython cases/render.py FLOW_FOLDER PICTURE.png [--field v] [--frames 0 6 24] [--size 1100 760]
# On a machine without a screen: xvfb-run -a pvpython ... (packages xvfb, xauth, libgl1-mesa-dri).
import argparse
import os
import sys
import xml.etree.ElementTree as xml

from paraview.simple import (
    Calculator,
    ColorBy,
    CreateView,
    GetColorTransferFunction,
    GetScalarBar,
    Render,
    SaveScreenshot,
    Show,
    Text,
    Threshold,
    Transform,
    XMLPolyDataReader,
)

parser = argparse.ArgumentParser()
parser.add_argument("folder")
parser.add_argument("picture")
parser.add_argument("--field", default="v", help="v (its magnitude), p, mu, phi, beta, gamma_dot")
parser.add_argument("--frames", type=int, nargs="+", help="numbers of frames; default: first, a quarter, last")
parser.add_argument("--size", type=int, nargs=2, default=[1100, 760])
options = parser.parse_args()

series = [
    (float(e.get("timestep")), os.path.join(options.folder, e.get("file")))
    for e in xml.parse(os.path.join(options.folder, "frames.pvd")).iter("DataSet")
]
chosen = options.frames or [0, len(series) // 4, len(series) - 1]
for number in chosen:
    if number >= len(series):
        sys.exit(f"there are frames 0 to {len(series) - 1}, not {number}")

units = {"v": "speed [m/s]", "p": "pressure [Pa]", "mu": "friction", "phi": "solid fraction",
         "beta": "dilation rate", "gamma_dot": "shear rate [1/s]"}
view = CreateView("RenderView")
view.ViewSize = options.size
view.Background = [1, 1, 1]
view.UseColorPaletteForBackground = 0
view.OrientationAxesVisibility = 0
view.InteractionMode = "2D"

readers = [XMLPolyDataReader(FileName=[series[n][1]]) for n in chosen]
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
    label = Show(Text(Text=f"t = {series[number][0]:.3f} s"), view)
    label.WindowLocation = "Any Location"
    label.FontSize = 18
    label.Color = [0.1, 0.1, 0.1]
    labels.append(label)

colours = GetColorTransferFunction(array)
colours.ApplyPreset("Viridis (matplotlib)", True)
colours.RescaleTransferFunction(lowest, highest)
bar = GetScalarBar(colours, view)
bar.Title = units.get(options.field, options.field)
bar.ComponentTitle = ""
bar.TitleColor = bar.LabelColor = [0.1, 0.1, 0.1]
bar.WindowLocation = "Any Location"
bar.Orientation = "Horizontal"
bar.Position = [0.62, 0.88]
bar.ScalarBarLength = 0.3
shown[-1].SetScalarBarVisibility(view, True)

# Look at all rows. The first rendering sets the camera by itself, so ours comes after it.
Render(view)
right = max(reader.GetDataInformation().GetBounds()[1] for reader in readers)
pitch = 1.12 * height
centre_x = 0.5 * (bounds[0] + right)
centre_y = 0.5 * (bounds[3] + bounds[2] - pitch * (len(chosen) - 1))
aspect = options.size[0] / options.size[1]
half = 0.52 * max(height + pitch * (len(chosen) - 1), (right - bounds[0]) / aspect)
view.CameraPosition = [centre_x, centre_y, 1]
view.CameraFocalPoint = [centre_x, centre_y, 0]
view.CameraViewUp = [0, 1, 0]
view.CameraParallelProjection = 1
view.CameraParallelScale = half
for row, label in enumerate(labels):
    middle = 0.5 * (bounds[2] + bounds[3]) - pitch * row
    label.Position = [0.62, 0.5 + 0.5 * (middle - centre_y) / half]
Render(view)
SaveScreenshot(options.picture, view, ImageResolution=options.size)
