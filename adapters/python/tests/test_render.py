"""Frames and light: known answers, and the same answers whatever the arrays look like."""

import tempfile

import numpy as np
import pytest
from vtkmodules.vtkIOImage import vtkPNGReader
from vtkmodules.util.numpy_support import vtk_to_numpy

import gloaming

#: A camera far away that looks along +y through the middle, nearly in parallel.
FAR = [{"position": [7.5, -1000, 7.5], "target": [7.5, 7.5, 7.5], "fov": 1.0}]


def ball(n=16, shift=0):
    z, y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j, -1 : 1 : n * 1j]
    return np.roll(np.exp(-4 * (x**2 + y**2 + z**2)), shift, axis=2)


def small(series, scene=None, **options):
    return gloaming.render(series, scene, size=(40, 30), device="cpu", **options)


def decoded(png):
    with tempfile.NamedTemporaryFile(suffix=".png") as file:
        file.write(png)
        file.flush()
        reader = vtkPNGReader()
        reader.SetFileName(file.name)
        reader.Update()
    image = reader.GetOutput()
    width, height, _ = image.GetDimensions()
    # VTK's first row is the lowest.
    return vtk_to_numpy(image.GetPointData().GetScalars()).reshape(height, width, 3)[::-1]


def test_coverage_follows_beer_and_lambert():
    scene = {"transfer": {"extinction": 0.1, "albedo": 0.0}, "cameras": FAR}
    frame = small(np.ones((16, 16, 16)), scene, range=(0, 1))
    # The box reaches half a voxel beyond the values: 16 lengths of extinction 0.1.
    assert frame.array[15, 20] == pytest.approx([0, 0, 0, 1 - np.exp(-1.6)], abs=1e-5)
    assert frame.array[0, 0, 3] == 0 and frame.array.shape == (30, 40, 4)
    # Half the spacing is half the path.
    nearer = [{"position": [3.75, -1000, 3.75], "target": [3.75, 3.75, 3.75], "fov": 1.0}]
    half = small(np.ones((16, 16, 16)), {**scene, "cameras": nearer}, range=(0, 1), spacing=0.5)
    assert half.array[15, 20, 3] == pytest.approx(1 - np.exp(-0.8), abs=1e-5)


def test_light_falls_off_exponentially_on_its_way():
    scene = {
        "transfer": {"extinction": 0.05, "albedo": 0.0},
        "lights": [{"direction": [0, 0, -1], "intensity": 3.0, "color": [1.0, 0.5, 0.25]}],
        "light": {"resolution": 1.0, "scattering": False},
    }
    lit = gloaming.light(np.ones((16, 12, 8), "float32"), scene, range=(0, 1), device="cpu")
    assert lit.shape == (16, 12, 8, 3) and lit.dtype == np.float32
    depth = 16 - (np.arange(16) + 0.5)
    expected = 3 * np.exp(-0.05 * depth)[:, None] * [1.0, 0.5, 0.25]
    # Short characteristics are exact in a homogeneous medium along an axis.
    np.testing.assert_allclose(lit[:, 6, 4], expected, rtol=1e-4)
    np.testing.assert_allclose(lit, np.broadcast_to(expected[:, None, None], lit.shape), rtol=1e-4)


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4", ">f8", "<f2", "u1", "i2", ">u2", "i4", "u4", "i8", "u8", "i1"])
def test_the_type_of_values_does_not_matter(dtype):
    values = (ball() * 100).round()
    assert np.array_equal(small(values.astype(dtype)).array, small(values).array)


def test_neither_does_their_place_in_memory():
    values = ball().astype("f4")[1:, :, 2:]
    expected = small(np.ascontiguousarray(values)).array
    spread = np.zeros((30, 16, 28), "f4")[::2, :, ::-2]
    spread[:] = values
    wide = np.zeros(values.shape, [("pad", "u1"), ("v", "f4")])
    wide["v"] = values
    for other in [values, np.asfortranarray(values), spread, wide["v"], values[::-1][::-1], values.tolist()]:
        assert np.array_equal(small(other).array, expected)
    fixed = values.copy()
    fixed.flags.writeable = False
    assert np.array_equal(small(fixed).array, expected)
    assert np.array_equal(small((ball() > 0.5)).array, small((ball() > 0.5).astype("u1")).array)


def test_axes_are_z_y_x():
    # A block in the corner of greatest x, least z: seen along +y it is at the lower right.
    values = np.zeros((16, 16, 16))
    values[:5, :, -5:] = 1
    frame = small(values, {"transfer": {"extinction": 10.0}, "cameras": [{"azimuth": 0, "elevation": 0}]})
    rows, columns = np.nonzero(frame.array[..., 3] > 0.5)
    assert rows.min() >= 15 and columns.min() >= 20


def test_masked_values_are_holes():
    values = np.ma.masked_less(ball(), 0.3)
    scene = {"transfer": {"opacity": [[0, 1], [1, 1]]}}
    masked, plain = small(values, scene), small(ball(), scene)
    holes = small(values.filled(np.nan), scene)
    assert np.array_equal(masked.array, holes.array)
    assert 0 < (masked.array[..., 3] > 0).sum() < (plain.array[..., 3] > 0).sum()


def test_a_series_is_an_array_a_list_or_a_generator():
    volumes = [ball(shift=n) for n in range(3)]
    expected = small(np.stack(volumes))
    assert isinstance(expected, gloaming.Frames) and [f.step for f in expected] == [0, 1, 2]
    for series in [volumes, tuple(volumes), (v for v in volumes)]:
        # A roll has the same range in every step, so that also the generator's is the same.
        assert np.array_equal(small(series).array, expected.array)
    assert expected.array.shape == (3, 30, 40, 4) and expected.rgb.shape == (3, 30, 40, 3)
    assert not np.array_equal(expected[0].array, expected[2].array)
    numbered = small(volumes, steps=[5, 7, 9], times=[0.1, 0.2, 0.3])
    assert [(f.step, f.time, f.camera) for f in numbered] == [(5, 0.1, "main"), (7, 0.2, "main"), (9, 0.3, "main")]
    with pytest.raises(ValueError, match="steps: fewer"):
        small(volumes, steps=[5])


def test_a_series_is_read_lazily():
    asked = []

    def simulation():
        for n in range(4):
            asked.append(n)
            yield ball(shift=n)

    frames = gloaming.frames(simulation(), size=(16, 12), range=(0, 1), device="cpu")
    assert asked == []
    assert next(frames).step == 0 and asked == [0]
    assert next(frames).step == 1 and asked == [0, 1]


def test_the_range_is_that_of_all_steps():
    dim, bright = 0.25 * ball(), ball()
    both = small([dim, bright])
    assert np.array_equal(both[0].array, small(dim, range=(dim.min(), bright.max())).array)
    own = small([dim, bright], {"field": {"range": "step"}})
    # Each between its own least and greatest value: the two volumes look alike, but for rounding to f32.
    np.testing.assert_allclose(own[0].array, own[1].array, atol=1e-3)
    assert not np.allclose(both[0].array, both[1].array, atol=1e-3)


def test_light_of_a_series_and_the_warm_start():
    series = np.stack([ball(12), ball(12, 1)])
    lit = gloaming.light(series, {"light": {"directions": 8, "tolerance": 1e-4}}, range=(0, 1), device="cpu")
    assert isinstance(lit, list) and [v.shape for v in lit] == [(6, 6, 6, 3)] * 2
    alone = gloaming.light(series[1], {"light": {"directions": 8, "tolerance": 1e-4}}, range=(0, 1), device="cpu")
    # Within twice the certified tolerance of the brightest light.
    assert np.abs(lit[1] - alone).max() <= 2e-4 * max(alone.max(), 1) * 4


def test_every_camera_gives_a_frame():
    scene = {"cameras": [{"name": "front"}, {"name": "side", "azimuth": 120}]}
    frames = small(ball(), scene)
    assert [(f.step, f.camera) for f in frames] == [(0, "front"), (0, "side")]


def test_scenes_are_text_files_or_dictionaries(tmp_path):
    text = "[transfer]\ncolormap = 'viridis'\nopacity = [[0.0, 0.0], [1.0, 0.4]]\n[[lights]]\ndirection = [1, 0, -1]\n"
    file = tmp_path / "scene.toml"
    file.write_text(text)
    nested = {
        "transfer": {"colormap": "viridis", "opacity": np.array([[0, 0], [1, 0.4]])},
        "lights": [{"direction": (1, 0, -1)}],
    }
    expected = small(ball(), text).array
    for scene in [file, str(file), nested]:
        assert np.array_equal(small(ball(), scene).array, expected)
    green = small(ball(), {"transfer": {"colormap": "viridis"}}).array
    assert np.array_equal(small(ball(), "transfer.colormap = 'viridis'").array, green)
    assert np.array_equal(small(ball(), {"transfer.colormap": "viridis"}).array, green)
    # An entry without keys is a light with every key at its default.
    lit = small(ball(), {"lights": [{}]}).array
    assert np.array_equal(lit, small(ball(), "[[lights]]\n").array) and not np.array_equal(lit, small(ball()).array)


def test_a_notebook_shows_frames():
    frames = small([ball(shift=n) for n in range(5)], {"render": {"overlay": ["time", "colorbar"]}})
    png = frames[2]._repr_png_()
    assert png == frames[2].png and np.array_equal(decoded(png), frames[2].rgb)
    assert frames[2].rgb.max() > 100
    sheet = decoded(frames._repr_png_())
    assert sheet.shape == (2 * 30, 3 * 40, 3)
    assert np.array_equal(sheet[30:60, 40:80], frames[4].rgb) and not sheet[30:60, 80:].any()
    assert frames[1:3]._repr_png_() != frames._repr_png_()
    big = gloaming.render(np.zeros((30, 4, 4, 4)), size=(600, 400), device="cpu")
    assert decoded(big.png).shape == (3 * 200, 4 * 300, 3)
    assert gloaming.Frames([])._repr_png_() is None
    assert repr(frames[2]).startswith("<gloaming.Frame of step 2, camera")


def test_display_is_background_exposure_and_tone_map():
    frame = small(np.zeros((8, 8, 8)), {"render": {"background": [0.18, 0.5, 1.0]}}, range=(0, 1))
    # 18 % grey is 118 in sRGB, 0.5 is 188.
    assert (frame.rgb == [118, 188, 255]).all() and not frame.array.any()
