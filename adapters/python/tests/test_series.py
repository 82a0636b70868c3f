"""Files to NumPy."""

import h5py
import numpy as np
import pytest

import gloaming


@pytest.fixture
def run(tmp_path):
    values = np.random.default_rng(3).random((4, 5, 6, 7))
    with h5py.File(tmp_path / "run.h5", "w") as file:
        data = file.create_dataset("density", data=values)
        data.attrs["spacing"] = [0.5, 0.25, 0.125]
        file["time"] = np.arange(4) * 0.1
        file["pressure"] = -values
    return tmp_path / "run.h5", values


def test_values_are_the_files(run):
    path, values = run
    series = gloaming.open(path, field="density")
    assert series.steps == [0, 1, 2, 3] and series.times == pytest.approx([0, 0.1, 0.2, 0.3]) and len(series) == 4
    assert np.array_equal(series.read(2), values[2].astype("f4"))
    exact = series.read(2, "float64")
    assert exact.dtype == np.float64 and np.array_equal(exact, values[2])
    assert all(np.array_equal(a, b.astype("f4")) for a, b in zip(series, values, strict=True))
    info = series.info()
    assert info["grid"]["size"] == [7, 6, 5] and info["grid"]["spacing"] == [0.5, 0.25, 0.125]
    assert {c["name"].strip("/") for c in info["candidates"]} >= {"density", "pressure"}
    # What is returned is the caller's.
    info["steps"].clear()
    assert len(series.info()["steps"]) == 4


def test_settings_override_the_file(run):
    path, _ = run
    series = gloaming.open([path], field="pressure", spacing=2, origin=(1, 2, 3), time_step=0.5)
    assert series.info()["grid"]["spacing"] == [2, 2, 2] and series.info()["grid"]["origin"] == [1, 2, 3]
    assert series.times == [0, 0.5, 1, 1.5]
    with pytest.raises(gloaming.FormatError, match="density"):
        gloaming.open(path)


def test_rendering_files_is_rendering_their_arrays(run):
    path, values = run
    series = gloaming.open(path, field="density")
    frames = gloaming.render(series, size=(40, 30), device="cpu")
    arrays = gloaming.render(values.astype("f4"), size=(40, 30), device="cpu", spacing=(0.5, 0.25, 0.125))
    assert [f.time for f in frames] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert np.array_equal(frames.array, arrays.array)
    with h5py.File(path) as file:
        mapped = gloaming.render(file["density"], size=(40, 30), device="cpu", spacing=(0.5, 0.25, 0.125))
    np.testing.assert_allclose(mapped.array, frames.array, atol=1e-4)


def test_raw_files(tmp_path):
    values = np.arange(2 * 3 * 4 * 5, dtype="<i2").reshape(2, 3, 4, 5)
    values.tofile(tmp_path / "dump.raw")
    series = gloaming.open(tmp_path / "dump.raw", raw="dims=5x4x3,dtype=i16le,steps=2")
    assert np.array_equal(series.read(1), values[1])
