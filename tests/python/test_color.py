"""Display images against OpenColorIO's own processor, and what goes wrong with names."""

import numpy as np
import PyOpenColorIO as ocio
import pytest
from PIL import Image

from dermis import color

PIXELS = [(0.0, 0.0, 0.0), (0.18, 0.18, 0.18), (1.0, 1.0, 1.0), (4.0, 0.5, 0.02), (0.02, 0.3, 16.0)]


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)


def reference_processor(display: str, view: str, looks: str = "") -> ocio.CPUProcessor:
    """OpenColorIO by another way than the module's: a plain DisplayViewTransform, one pixel at a time."""
    config = ocio.Config.CreateFromBuiltinConfig(color.BUILTIN_CONFIG)
    group = ocio.GroupTransform()
    if looks:
        group.appendTransform(ocio.LookTransform("lin_rec709_srgb", "lin_rec709_srgb", looks))
    group.appendTransform(ocio.DisplayViewTransform("lin_rec709_srgb", display, view))
    return config.getProcessor(group).getDefaultCPUProcessor()


@pytest.mark.parametrize("pixel", PIXELS)
def test_default_is_the_aces_sdr_view_on_an_srgb_display(pixel):
    transform = color.DisplayTransform()
    assert (transform.display, transform.view) == ("sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)")
    expected = reference_processor(transform.display, transform.view).applyRGB(list(pixel))
    np.testing.assert_allclose(transform.apply(np.array([[pixel]]))[0, 0], np.clip(expected, 0, 1), atol=2e-4)


@pytest.mark.parametrize("pixel", PIXELS)
def test_display_and_view_by_name(pixel):
    transform = color.DisplayTransform(display="Gamma 2.2 Rec.709 - Display", view="Un-tone-mapped")
    expected = reference_processor(transform.display, transform.view).applyRGB(list(pixel))
    np.testing.assert_allclose(transform.apply(np.array(pixel)), np.clip(expected, 0, 1), atol=2e-4)


def test_look_changes_saturated_colours():
    saturated = np.array([[4.0, 0.0, 4.0]])
    look = "ACES 1.3 Reference Gamut Compression"
    names = {"display": "sRGB - Display", "view": "Un-tone-mapped"}
    looked = color.DisplayTransform(**names, look=look).apply(saturated)
    assert np.abs(looked - color.DisplayTransform(**names).apply(saturated)).max() > 0.01


def test_input_is_not_changed_and_strides_do_not_matter():
    image = np.random.default_rng(1).random((5, 7, 4), dtype=np.float32)
    before = image.copy()
    transform = color.DisplayTransform()
    whole = transform.apply(image[::2, ::3, :3])
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(whole[1, 2], transform.apply(image[2, 6, :3]))


def test_srgb_mode_is_the_bare_curve():
    values = color.DisplayTransform("sRGB").apply(np.array([[0.0, 0.002, 0.0031308], [0.18, 1.0, 9.0]]))
    np.testing.assert_allclose(values[0], [0.0, 0.02584, 0.04045], atol=1e-5)
    np.testing.assert_allclose(values[1], [0.461356, 1.0, 1.0], atol=1e-5)


def test_disabled_mode_keeps_linear_values():
    np.testing.assert_allclose(
        color.DisplayTransform("disabled").apply(np.array([-1.0, 0.25, 3.0])), [0, 0.25, 1]
    )


def test_not_finite_pixels_become_black():
    pixels = np.array([[np.nan, 1.0, 1.0], [1.0, np.inf, 1.0]])
    black = color.DisplayTransform().apply(np.zeros(3))
    np.testing.assert_array_equal(color.DisplayTransform().apply(pixels), [black, black])


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"display": "Kodak"}, "Unknown OpenColorIO display 'Kodak'.*sRGB - Display, Display P3"),
        ({"view": "Pretty"}, "Unknown OpenColorIO view 'Pretty'.*Un-tone-mapped"),
        ({"look": "Sunny"}, "Unknown OpenColorIO look 'Sunny'.*Reference Gamut Compression"),
        (
            {"config": "/nowhere/config.ocio"},
            "/nowhere/config.ocio.*Built-in configs: .*" + color.BUILTIN_CONFIG,
        ),
    ],
)
def test_unknown_names_list_what_exists(names, said):
    with pytest.raises(color.ColorError, match=said):
        color.DisplayTransform(**names)


def test_config_without_linear_rec709_is_refused(tmp_path):
    config = ocio.Config.CreateRaw()
    (tmp_path / "raw.ocio").write_text(config.serialize())
    with pytest.raises(color.ColorError, match="no linear Rec.709 colour space.*raw"):
        color.DisplayTransform(config=str(tmp_path / "raw.ocio"))


def test_environment_names_the_config(monkeypatch):
    other = "cg-config-v1.0.0_aces-v1.3_ocio-v2.1"
    monkeypatch.setenv("OCIO", f"ocio://{other}")
    assert color.DisplayTransform().config_name == f"ocio://{other}"
    assert color.DisplayTransform(config=color.BUILTIN_CONFIG).config_name == color.BUILTIN_CONFIG


def test_quantize_rounds_to_nearest():
    values = np.array([0.0, 0.4 / 255, 0.6 / 255, 254.6 / 255, 1.0, 2.0, np.nan])
    assert color.quantize(values).tolist() == [0, 0, 1, 255, 255, 255, 0]


def test_png_unpremultiplies_and_keeps_alpha(tmp_path):
    transform = color.DisplayTransform("sRGB")
    premultiplied = np.array([[[0.25, 0.25, 0.25, 0.5], [0.5, 0.5, 0.5, 1.0], [0.5, 0.0, 0.0, 0.0]]])
    color.write_display_image(tmp_path / "a.png", premultiplied, transform)
    image = Image.open(tmp_path / "a.png")
    assert image.mode == "RGBA"
    # 0.5 encoded is 188 of 255.
    assert np.array(image)[0].tolist() == [[188, 188, 188, 128], [188, 188, 188, 255], [188, 0, 0, 0]]


def test_jpeg_is_over_black(tmp_path):
    premultiplied = np.broadcast_to(np.array([0.5, 0.5, 0.5, 0.5], np.float32), (16, 16, 4))
    color.write_display_image(tmp_path / "a.jpg", premultiplied, color.DisplayTransform("sRGB"))
    image = Image.open(tmp_path / "a.jpg")
    assert (image.mode, image.format) == ("RGB", "JPEG")
    assert np.abs(np.array(image).astype(int) - 188).max() <= 1
