# What render.py and render_pair.py share: frames of a flow with their times, an empty white view, texts, the bar of colours.
import os
import xml.etree.ElementTree as xml

from paraview.simple import CreateView, GetColorTransferFunction, GetScalarBar, Show, Text


def series(folder):
    """Times and .vtp files of a flow, from FOLDER/frames.pvd."""
    entries = xml.parse(os.path.join(folder, "frames.pvd")).iter("DataSet")
    return [(float(e.get("timestep")), os.path.join(folder, e.get("file"))) for e in entries]


def white_view(size):
    view = CreateView("RenderView")
    view.ViewSize = size
    view.Background = [1, 1, 1]
    view.UseColorPaletteForBackground = 0
    view.OrientationAxesVisibility = 0
    view.InteractionMode = "2D"
    return view


def text(view, content, size):
    shown = Show(Text(Text=content), view)
    shown.WindowLocation = "Any Location"
    shown.FontSize = size
    shown.Color = [0.1, 0.1, 0.1]
    return shown


def colour_by(view, array, title, lowest, highest, position, length):
    colours = GetColorTransferFunction(array)
    colours.ApplyPreset("Viridis (matplotlib)", True)
    colours.RescaleTransferFunction(lowest, highest)
    bar = GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle = title, ""
    bar.TitleColor = bar.LabelColor = [0.1, 0.1, 0.1]
    bar.WindowLocation = "Any Location"
    bar.Orientation = "Horizontal"
    bar.Position = position
    bar.ScalarBarLength = length


def look_at(view, centre, half_height):
    """The first rendering sets the camera by itself, so this comes after it."""
    view.CameraPosition = [*centre, 1]
    view.CameraFocalPoint = [*centre, 0]
    view.CameraViewUp = [0, 1, 0]
    view.CameraParallelProjection = 1
    view.CameraParallelScale = half_height
