# Opens a .pvd series with ParaView's own reader (pvpython) and prints what it saw, for test_frame.cpp to compare.
#   pvpython read_series.py SERIES.pvd ARRAY
import sys

from paraview import servermanager
from paraview.simple import PVDReader

reader = PVDReader(FileName=sys.argv[1])
reader.UpdatePipelineInformation()
for time in list(reader.TimestepValues):
    reader.UpdatePipeline(time)
    data = servermanager.Fetch(reader)
    array = data.GetPointData().GetArray(sys.argv[2])
    values = [
        array.GetComponent(i, c)
        for i in range(array.GetNumberOfTuples())
        for c in range(array.GetNumberOfComponents())
    ]
    points = [v for i in range(data.GetNumberOfPoints()) for v in data.GetPoint(i)]
    print("seen", repr(time), data.GetNumberOfPoints(), data.GetNumberOfVerts(), len(values), len(points))
    print("values", *map(repr, values))
    print("points", *map(repr, points))
