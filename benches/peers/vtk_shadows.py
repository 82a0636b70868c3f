#!/usr/bin/env python3
"""The single-scattering picture of tests/data/plume_128.h5, by VTK's ray caster with volumetric shadows and by gloaming.

Both are compared with the same truth (tests/data/single_256.npy); VTK's picture is scaled by the factor that fits it best,
gloaming's is radiance and stays as it is. Times are those of one picture with its light, in a process that is warm.

    ./x bench peers
"""
import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPiecewiseFunction
from vtkmodules.vtkRenderingCore import (
    vtkCamera,
    vtkColorTransferFunction,
    vtkLight,
    vtkRenderer,
    vtkRenderWindow,
    vtkVolume,
    vtkVolumeProperty,
    vtkWindowToImageFilter,
)
from vtkmodules.vtkRenderingVolumeOpenGL2 import vtkOpenGLGPUVolumeRayCastMapper
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the renderer)

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
EXTINCTION = 30.0
SIZE = 256


def image(density):
    """Values in the middle of the voxels of the unit box; one more layer all round, so that VTK's box covers it."""
    padded = np.pad(density, 1, mode="edge")
    n = density.shape[0]
    data = vtkImageData()
    data.SetDimensions(*padded.shape[::-1])
    data.SetSpacing(1 / n, 1 / n, 1 / n)
    data.SetOrigin(-0.5 / n, -0.5 / n, -0.5 / n)
    array = numpy_to_vtk(padded.ravel(), deep=True)
    array.SetName("density")
    data.GetPointData().SetScalars(array)
    return data


def window(density, step):
    """VTK's scene with rays sampled every `step` voxels."""
    voxel = 1 / density.shape[0]
    mapper = vtkOpenGLGPUVolumeRayCastMapper()
    mapper.SetInputData(image(density))
    mapper.AutoAdjustSampleDistancesOff()
    mapper.SetSampleDistance(step * voxel)
    mapper.SetGlobalIlluminationReach(1.0)
    mapper.SetVolumetricScatteringBlending(2.0)
    mapper.CroppingOn()
    mapper.SetCroppingRegionPlanes(0, 1, 0, 1, 0, 1)
    mapper.SetCroppingRegionFlagsToSubVolume()

    look = vtkVolumeProperty()
    opacity = vtkPiecewiseFunction()
    for value in np.linspace(0, 1, 256):
        opacity.AddPoint(value, 1 - np.exp(-EXTINCTION * voxel * value))
    color = vtkColorTransferFunction()
    color.AddRGBPoint(0, 1, 1, 1)
    color.AddRGBPoint(1, 1, 1, 1)
    look.SetScalarOpacity(opacity)
    look.SetScalarOpacityUnitDistance(voxel)
    look.SetColor(color)
    look.SetInterpolationTypeToLinear()
    look.ShadeOn()
    look.SetAmbient(0)
    look.SetDiffuse(1)
    look.SetSpecular(0)
    look.SetScatteringAnisotropy(0)
    volume = vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(look)

    light = vtkLight()
    light.SetLightTypeToSceneLight()
    light.PositionalOff()
    light.SetFocalPoint(0.5, 0.5, 0.5)
    light.SetPosition(0.5 - 0.6, 0.5 - 0.4, 0.5 + 0.7)
    renderer = vtkRenderer()
    renderer.SetBackground(0, 0, 0)
    renderer.AutomaticLightCreationOff()
    renderer.AddLight(light)
    renderer.AddVolume(volume)
    camera = vtkCamera()
    camera.SetPosition(0.5, -2.0, 0.55)
    camera.SetFocalPoint(0.5, 0.5, 0.5)
    camera.SetViewUp(0, 0, 1)
    camera.SetViewAngle(28)
    renderer.SetActiveCamera(camera)
    renderer.ResetCameraClippingRange()
    target = vtkRenderWindow()
    target.SetOffScreenRendering(1)
    target.SetMultiSamples(0)
    target.SetSize(SIZE, SIZE)
    target.AddRenderer(renderer)
    return target, camera


def picture(target):
    grab = vtkWindowToImageFilter()
    grab.SetInput(target)
    grab.ReadFrontBufferOff()
    grab.ShouldRerenderOff()
    grab.Update()
    pixels = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
    return pixels.reshape(SIZE, SIZE, -1)[::-1, :, 0].astype(float)


def vtk(density, truth, step, runs):
    """Seconds (the best of `runs`) and RMSE after the best-fit scale."""
    target, camera = window(density, step)
    target.Render()
    times = []
    for _ in range(runs):
        # A camera that was touched makes VTK draw again.
        camera.Modified()
        begun = time.perf_counter()
        target.Render()
        target.WaitForCompletion()
        times.append(time.perf_counter() - begun)
    seen = picture(target)
    if seen.max() == 0:
        sys.exit("VTK drew nothing: is there an OpenGL driver? Debian: apt-get install libosmesa6 libegl1 libgl1-mesa-dri")
    scale = (seen * truth).sum() / (seen * seen).sum()
    return min(times), np.sqrt(((scale * seen - truth) ** 2).mean())


def gloaming():
    """What benches/reference.rs prints: one JSON object a setting."""
    command = ["cargo", "bench", "--quiet", "--bench", "reference", "--", "--json"]
    lines = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    return [json.loads(line) for line in lines if line.startswith("{")]


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--runs", type=int, default=5)
    arguments.add_argument("--vtk-only", action="store_true", help="leave gloaming out")
    arguments = arguments.parse_args()
    density = h5py.File(DATA / "plume_128.h5")["density"][:]
    truth = np.load(DATA / "single_256.npy").astype(float)

    steps = (2.0, 1.0)
    peers = [(f"VTK volumetric shadows, step {s} voxels", *vtk(density, truth, s, arguments.runs)) for s in steps]
    print(f"{'':44} {'seconds':>9} {'RMSE':>9}")
    for name, seconds, rmse in peers:
        print(f"{name:44} {seconds:9.4f} {rmse:9.2e}")
    if arguments.vtk_only:
        return
    for ours in gloaming():
        print(f"{'gloaming, ' + ours['setting']:44} {ours['seconds']:9.4f} {ours['rmse']:9.2e}", end="")
        fair = [seconds for _, seconds, rmse in peers if rmse >= ours["rmse"]]
        print(f"   {min(fair) / ours['seconds']:.0f} times as fast as VTK's fastest at no more error" if fair else "")


if __name__ == "__main__":
    main()
