"""Reads a temporal image with VTK's own reader: prints what it says as JSON, and writes the values of all steps, in the
order of the times, as f32.
usage: read_with_vtk.py FILE ARRAY VALUES_OUT"""
import json
import sys

try:
    import numpy as np
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError as e:
    sys.exit(f"this test reads files with VTK's own reader ({e})\n  try: pip install vtk numpy")

path, name, out = sys.argv[1:4]
reader = vtk.vtkXdmfReader() if path.endswith((".xmf", ".xdmf")) else vtk.vtkHDFReader()
reader.SetFileName(path)
reader.UpdateInformation()
information = reader.GetOutputInformation(0)
key = vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()
times = list(information.Get(key)) if information.Has(key) else [None]
steps = []
with open(out, "wb") as values:
    for time in times:
        reader.Update() if time is None else reader.UpdateTimeStep(time)
        image = reader.GetOutputDataObject(0)
        array = image.GetPointData().GetArray(name)
        steps.append({
            "kind": image.GetClassName(),
            "size": image.GetDimensions(),
            "spacing": image.GetSpacing(),
            "origin": image.GetOrigin(),
            "components": array.GetNumberOfComponents(),
            "type": array.GetDataTypeAsString(),
        })
        vtk_to_numpy(array).astype(np.float32, copy=False).tofile(values)
print(json.dumps({"times": times, "steps": steps}))
