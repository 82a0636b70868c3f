"""What is wrong is an exception of the class that says who can act, and of the built-in one that fits."""

import pickle

import numpy as np
import pytest

import gloaming

BOX = np.zeros((6, 6, 6), "float32")


def small(array=BOX, scene=None, **options):
    return gloaming.render(array, scene, size=(8, 6), device=options.pop("device", "cpu"), **options)


def test_scenes():
    with pytest.raises(gloaming.SceneError, match="directions") as e:
        small(scene={"light": {"directons": 8}})
    assert (e.value.key, e.value.line) == ("light.directons", None) and isinstance(e.value, ValueError)
    with pytest.raises(gloaming.SceneError) as e:
        small(scene="[light]\ntolerance = -1\n")
    assert (e.value.key, e.value.line) == ("light.tolerance", 2) and e.value.reason in str(e.value)
    with pytest.raises(gloaming.SceneError, match="colormap"):
        small(scene="transfer.colormap = 'no such'")
    with pytest.raises(TypeError, match="no place in a scene"):
        small(scene={"light": {"tolerance": object()}})


def test_files(tmp_path):
    with pytest.raises(gloaming.IoError) as e:
        small(scene=tmp_path / "none.toml")
    assert isinstance(e.value, OSError) and e.value.errno == 2 and e.value.filename.endswith("none.toml")
    with pytest.raises(gloaming.FormatError) as e:
        gloaming.open(tmp_path / "none.h5")
    assert e.value.path.name == "none.h5" and e.value.found and isinstance(e.value, ValueError)
    (tmp_path / "text.h5").write_text("not HDF5")
    with pytest.raises(gloaming.FormatError, match="signature") as e:
        gloaming.open(tmp_path / "text.h5")
    assert e.value.remedy and e.value.remedy in str(e.value)


@pytest.mark.parametrize(
    "array, said",
    [
        (np.zeros((4, 4)), "shape"),
        (np.zeros((4, 4, 4), complex), "complex128"),
        (np.zeros((4, 4, 4), "U3"), "<U3"),
        (np.zeros((4, 0, 4)), "nothing to light"),
        (np.zeros((4, 4, 4), "datetime64[s]"), "datetime64"),
        (np.array([[[None]]]), "object"),
    ],
)
def test_arrays_that_cannot_be_shown(array, said):
    with pytest.raises(gloaming.UnsupportedError, match=said) as e:
        small(array, range=(0, 1))
    assert isinstance(e.value, NotImplementedError)


def test_geometry():
    for spacing in [0, -1, (1, 1, np.nan)]:
        with pytest.raises(gloaming.UnsupportedError, match="spacing"):
            small(spacing=spacing)
    with pytest.raises(ValueError, match="three numbers"):
        small(spacing=(1, 1))


def test_a_grid_that_changes_within_a_rendered_series():
    with pytest.raises(gloaming.GloamingError, match="grid"):
        small([BOX, np.zeros((5, 6, 6))], range=(0, 1))


def test_devices():
    with pytest.raises(gloaming.DeviceError) as e:
        small(device="no such adapter")
    assert isinstance(e.value, RuntimeError)


def test_series_have_steps_by_number(tmp_path):
    import h5py

    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["density"] = np.zeros((2, 3, 4, 5))
    series = gloaming.open(tmp_path / "run.h5")
    with pytest.raises(LookupError, match="no step 7 among the 2, which are numbered 0 to 1"):
        series.read(7)


def test_every_class_is_a_gloaming_error():
    classes = [getattr(gloaming, name) for name in gloaming.__all__ if name.endswith("Error")]
    assert len(classes) == 9 and all(issubclass(c, gloaming.GloamingError) for c in classes)
    # They travel between processes.
    error = gloaming.FormatError("said", path="p", found="f", remedy="r")
    assert str(pickle.loads(pickle.dumps(error))) == "said"
