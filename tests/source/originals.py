"""Writes files with the software whose formats they are, and says in FOLDER/expected.json what is in them.

usage: originals.py FOLDER   (needs h5py, numpy, netCDF4, xarray, h5netcdf, openpmd-api, pynrrd, meshio, vtk)
"""

import json
import os
import sys

import h5py
import meshio
import netCDF4
import nrrd
import numpy as np
import openpmd_api as openpmd
import vtk
import xarray
from vtk.util import numpy_support
from vtk.util.vtkAlgorithm import VTKPythonAlgorithmBase

FOLDER = sys.argv[1]
NZ, NY, NX = 6, 9, 11
CASES = []
RNG = np.random.default_rng(20261122)


def at(name):
    return os.path.join(FOLDER, name)


def volume(step, shape=(NZ, NY, NX)):
    """No two values alike, every step another."""
    z, y, x = np.indices(shape)
    return x + 20.0 * y + 400.0 * z + 8000.0 * step + RNG.random(shape).round(3)


def figures(step, time, values):
    """Figures of a volume (z, y, x); values that are masked or not finite do not count."""
    values = np.ma.masked_invalid(np.ma.asarray(values, "f8"))
    nz, ny, nx = values.shape
    probe = values[7 * nz // 10, 2 * ny // 5, nx // 5]
    valid = values.compressed()
    return {
        "step": step,
        "time": time,
        "min": valid.min(),
        "max": valid.max(),
        "mean": valid.mean(),
        "std": valid.std(),
        "valid": int(valid.size),
        "probe": None if probe is np.ma.masked else float(probe),
    }


def case(file, layout, steps, spacing, origin, field=None, component=None, warns=(), **more):
    size = list(more.pop("size", (NX, NY, NZ)))
    CASES.append(
        {
            "file": file,
            "layout": layout,
            "field": field,
            "component": component,
            "size": size,
            "spacing": list(spacing),
            "origin": list(origin),
            "steps": steps,
            "warns": list(warns),
            **more,
        }
    )


def netcdf4():
    """Packed shorts with fills over an unlimited time; depths that stretch, positive downwards, with bounds."""
    with netCDF4.Dataset(at("ocean.nc"), "w") as f:
        for name, n in (("time", None), ("depth", NZ), ("lat", NY), ("lon", NX), ("nv", 2)):
            f.createDimension(name, n)
        time = f.createVariable("time", "f8", ("time",))
        time.units = "hours since 2001-01-01 00:00:00"
        faces = np.array([0, 10, 20, 40, 80, 160, 320.0])
        depth = f.createVariable("depth", "f4", ("depth",))
        depth.units, depth.positive, depth.axis, depth.bounds = "degrees", "down", "Z", "depth_bnds"
        depth[:] = 0.5 * (faces[1:] + faces[:-1])
        f.createVariable("depth_bnds", "f4", ("depth", "nv"))[:] = np.stack([faces[:-1], faces[1:]], 1)
        for name, first, apart, n, standard in (
            ("lat", 40.0, -0.5, NY, "latitude"),
            ("lon", -10.0, 0.25, NX, "longitude"),
        ):
            axis = f.createVariable(name, "f8", (name,))
            axis.units, axis.standard_name = "degrees", standard
            axis[:] = first + apart * np.arange(n)
        heat = f.createVariable("heat", "i2", ("time", "depth", "lat", "lon"), fill_value=-32768, zlib=True)
        heat.scale_factor, heat.add_offset, heat.units, heat.missing_value = 0.01, 20.0, "degC", np.int16(-32767)
        steps = []
        for n in range(3):
            time[n] = 6.0 * n
            values = np.ma.masked_array(20 + 0.01 * (volume(0) % 900).round() + n, mask=np.zeros((NZ, NY, NX), bool))
            values.mask[-1, :4] = True
            heat[n] = values
            steps.append(figures(n, 6.0 * n, f["heat"][n]))
        f.set_auto_mask(False)
        f.createVariable("map", "f4", ("time", "lat", "lon"))[:] = 1.0
    case(
        "ocean.nc",
        "netCDF-4",
        steps,
        (0.25, 0.5, 47.0),
        (-10.0, 40.0, -5.0),
        warns=["y coordinates fall", "z coordinates are uneven", "positive downwards"],
        units="degC",
        time_units="h",
    )
    with netCDF4.Dataset(at("classic.nc"), "w", format="NETCDF3_CLASSIC") as f:
        f.createDimension("x", 4)
        f.createVariable("q", "f4", ("x",))[:] = 1.0


def xarrays():
    """(z, y, x, time) with holes, in both of xarray's engines; one file for each time as well."""
    values = np.stack([volume(n) for n in range(2)], -1)
    values[2, 3:5, 4, :] = np.nan
    values[0, 0, 0, 1] = np.inf
    coords = {
        "z": 5.0 + 2.0 * np.arange(NZ),
        "y": -1.0 + 0.5 * np.arange(NY),
        "x": 0.25 * np.arange(NX),
        "time": [0.5, 0.75],
    }
    whole = xarray.Dataset({"q": (("z", "y", "x", "time"), values)}, coords)
    for engine in ("netcdf4", "h5netcdf"):
        file = f"xarray_{engine}.nc"
        whole.to_netcdf(at(file), engine=engine)
        steps = [figures(n, t, values[..., n]) for n, t in enumerate([0.5, 0.75])]
        case(file, "netCDF-4", steps, (0.25, 0.5, 2.0), (0.0, -1.0, 5.0))
    for n in range(2):
        part = whole.isel(time=[n]).transpose("time", "x", "y", "z")
        part.to_netcdf(at(f"xarray_part_{10 * n + 1}.nc"), engine="netcdf4")
    steps = [figures(10 * n + 1, t, values[..., n]) for n, t in enumerate([0.5, 0.75])]
    case("xarray_part_*.nc", "netCDF-4", steps, (0.25, 0.5, 2.0), (0.0, -1.0, 5.0))


def openpmds():
    """A scalar, a vector and a constant record; iterations in one file and in one file each."""
    for file, layout in (("openpmd.h5", "openPMD groupBased"), ("openpmd_%06T.h5", "openPMD fileBased")):
        series = openpmd.Series(at(file), openpmd.Access.create)
        scalar, vector = [], []
        for n in (5, 50):
            step = series.iterations[n]
            step.time, step.dt, step.time_unit_SI = 0.5 * n, 0.5, 1e-3
            for name, parts in (("rho", [openpmd.Mesh_Record_Component.SCALAR]), ("E", ["x", "y", "z"])):
                mesh = step.meshes[name]
                mesh.geometry, mesh.axis_labels = openpmd.Geometry.cartesian, ["z", "y", "x"]
                mesh.grid_spacing, mesh.grid_global_offset, mesh.grid_unit_SI = [2.0, 1.0, 0.5], [3.0, 2.0, 1.0], 0.5
                kept = []
                for c, part in enumerate(parts):
                    values = volume(n + c)
                    component = mesh[part]
                    component.position, component.unit_SI = [0.5, 0.5, 0.5], 1.0
                    component.reset_dataset(openpmd.Dataset(values.dtype, values.shape))
                    if part == "y":
                        component.make_constant(2.5)
                        values = np.full_like(values, 2.5)
                    else:
                        component.store_chunk(values)
                    kept.append(values)
                total = kept[0] if name == "rho" else np.sqrt(sum(v**2 for v in kept))
                (scalar if name == "rho" else vector).append(figures(n, 0.5e-3 * n, total))
            step.close()
        series.close()
        grid = ((0.25, 0.5, 1.0), (0.625, 1.25, 2.0))
        case(file, layout, scalar, *grid, field="rho", time_units="s")
        case(file, layout, vector, *grid, field="E")
        case(file, layout, [{**v, **{k: 2.5 for k in ("min", "max", "mean", "probe")}, "std": 0.0} for v in vector],
             *grid, field="E", component="y")


class Steps(VTKPythonAlgorithmBase):
    """An image at three times, for VTK's HDF writer."""

    TIMES = [0.25, 1.0, 4.0]

    def __init__(self, values):
        super().__init__(nInputPorts=0, nOutputPorts=1, outputType="vtkImageData")
        self.values = values

    def RequestInformation(self, _request, _inputs, outputs):
        info, keys = outputs.GetInformationObject(0), vtk.vtkStreamingDemandDrivenPipeline
        info.Set(keys.WHOLE_EXTENT(), (0, NX - 1, 0, NY - 1, 0, NZ - 1), 6)
        info.Set(keys.TIME_STEPS(), self.TIMES, 3)
        info.Set(keys.TIME_RANGE(), [self.TIMES[0], self.TIMES[-1]], 2)
        return 1

    def RequestData(self, _request, _inputs, outputs):
        info, keys = outputs.GetInformationObject(0), vtk.vtkStreamingDemandDrivenPipeline
        time = info.Get(keys.UPDATE_TIME_STEP()) if info.Has(keys.UPDATE_TIME_STEP()) else self.TIMES[0]
        image = vtk.vtkImageData.GetData(info)
        fill_image(image, self.values[self.TIMES.index(time)])
        image.GetInformation().Set(vtk.vtkDataObject.DATA_TIME_STEP(), time)
        return 1


def fill_image(image, values):
    image.SetDimensions(NX, NY, NZ)
    image.SetSpacing(0.5, 1.0, 2.0)
    image.SetOrigin(-1.0, 0.0, 3.0)
    add(image.GetPointData(), "q", values)
    add(image.GetCellData(), "c", values[1:, 1:, 1:])


def add(to, name, values):
    array = numpy_support.numpy_to_vtk(np.ascontiguousarray(values).ravel(), deep=1)
    array.SetName(name)
    to.AddArray(array)


def vtks():
    values = [volume(n) for n in range(3)]
    writer = vtk.vtkHDFWriter()
    source = Steps(values)
    writer.SetInputConnection(source.GetOutputPort())
    writer.SetFileName(at("steps.vtkhdf"))
    writer.SetWriteAllTimeSteps(True)
    writer.Write()
    points = ((0.5, 1.0, 2.0), (-1.0, 0.0, 3.0))
    steps = [figures(n, Steps.TIMES[n], values[n]) for n in range(3)]
    case("steps.vtkhdf", "vtkhdf ImageData, temporal", steps, *points, field="q")
    cells = ((0.5, 1.0, 2.0), (-0.75, 0.5, 4.0))
    steps = [figures(n, Steps.TIMES[n], values[n][1:, 1:, 1:]) for n in range(3)]
    case("steps.vtkhdf", "vtkhdf ImageData, temporal", steps, *cells, field="c", size=(NX - 1, NY - 1, NZ - 1))

    image = vtk.vtkImageData()
    fill_image(image, values[0])
    for file, writer, layout in (
        ("image.vti", vtk.vtkXMLImageDataWriter(), "VTK XML"),
        ("image.vtk", vtk.vtkStructuredPointsWriter(), "VTK legacy"),
    ):
        image.GetPointData().SetActiveScalars("q")
        writer.SetFileName(at(file))
        writer.SetInputData(image)
        writer.Write()
        case(file, layout, [figures(0, None, values[0])], *points, field="q")
    writer = vtk.vtkMetaImageWriter()
    writer.SetFileName(at("image.mha"))
    writer.SetInputData(image)
    writer.Write()
    case("image.mha", "MetaImage", [figures(0, None, values[0])], *points)

    grid = vtk.vtkRectilinearGrid()
    grid.SetDimensions(NX, NY, NZ)
    x, y, z = 0.5 * np.arange(NX) - 1, -np.cos(np.pi * (np.arange(NY) + 0.5) / NY), np.arange(NZ) ** 2.0
    for axis, line in (("X", x), ("Y", y), ("Z", z)):
        getattr(grid, f"Set{axis}Coordinates")(numpy_support.numpy_to_vtk(line, deep=1))
    add(grid.GetPointData(), "q", values[1])
    add(grid.GetCellData(), "c", values[1][1:, 1:, 1:])
    warns = ["y coordinates are uneven", "z coordinates are uneven"]
    for file, make, layout, setting in (
        ("uneven_text.vtk", vtk.vtkRectilinearGridWriter, "VTK legacy", "SetFileTypeToASCII"),
        ("uneven_binary.vtk", vtk.vtkRectilinearGridWriter, "VTK legacy", "SetFileTypeToBinary"),
        ("uneven_text.vtr", vtk.vtkXMLRectilinearGridWriter, "VTK XML", "SetDataModeToAscii"),
        ("uneven_binary.vtr", vtk.vtkXMLRectilinearGridWriter, "VTK XML", "SetDataModeToAppended"),
    ):
        writer = make()
        getattr(writer, setting)()
        writer.SetFileName(at(file))
        writer.SetInputData(grid)
        writer.Write()
        mean = (0.5, (y[-1] - y[0]) / (NY - 1), (z[-1] - z[0]) / (NZ - 1))
        close = 1e-5 if "text" in file else 1e-6
        case(file, layout, [figures(0, None, values[1])], mean, (x[0], y[0], z[0]), field="q", warns=warns, close=close)
        middle = [0.5 * (v[1:] + v[:-1]) for v in (x, y, z)]
        mean = [(v[-1] - v[0]) / (len(v) - 1) for v in middle]
        steps = [figures(0, None, values[1][1:, 1:, 1:])]
        size = (NX - 1, NY - 1, NZ - 1)
        case(file, layout, steps, mean, [v[0] for v in middle], field="c", warns=warns, size=size, close=close)


def nrrds():
    values = volume(4)
    for coding in ("raw", "gzip", "ascii"):
        header = {"space directions": np.diag([0.5, 1.0, 2.0]), "space origin": [1.0, 2.0, 3.0], "encoding": coding}
        for file in (f"{coding}.nrrd", f"{coding}.nhdr"):
            nrrd.write(at(file), values.transpose(2, 1, 0), header)
            case(file, "NRRD", [figures(0, None, values)], (0.5, 1.0, 2.0), (1.0, 2.0, 3.0))
    nrrd.write(at("bzip2.nrrd"), values.transpose(2, 1, 0), {"encoding": "bzip2"})


def h5pys():
    """Groups of steps, and one array with everything last."""
    values = [volume(n) for n in range(3)]
    with h5py.File(at("groups.h5"), "w") as f:
        f.attrs["spacing"], f.attrs["origin"] = [0.5, 1.0, 2.0], [1.0, 2.0, 3.0]
        for n in range(3):
            group = f.create_group(f"Timestep_{8 + n}")
            group.attrs["time"] = 0.1 * n
            group.create_dataset("gas/q", data=values[n].astype(">f8"), chunks=True, compression="gzip", shuffle=True)
    steps = [figures(8 + n, 0.1 * n, values[n]) for n in range(3)]
    case("groups.h5", "hdf5 group per step", steps, (0.5, 1.0, 2.0), (1.0, 2.0, 3.0))
    with h5py.File(at("last.h5"), "w") as f:
        both = np.stack([np.stack([values[n], -values[n]], 0) for n in range(3)], 0)
        f.create_dataset("v", data=both.transpose(4, 3, 2, 1, 0))
    steps = [figures(n, None, -values[n]) for n in range(3)]
    case("last.h5", "hdf5 4-D dataset", steps, (1, 1, 1), (0, 0, 0), component="1", axes="xyzct")


def meshios():
    """Cells without order, which are no grid: to be refused."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))], point_data={"q": np.arange(4.0)})
    for file in ("tetra.xdmf", "tetra.vtu", "tetra.vtk"):
        mesh.write(at(file))


for write in (netcdf4, xarrays, openpmds, vtks, nrrds, h5pys, meshios):
    write()
with open(at("expected.json"), "w") as f:
    json.dump(CASES, f, indent=1)
