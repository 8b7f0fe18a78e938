"""IES profiles: the file format, and pictures against numpy's own interpolation and quadrature."""

import numpy as np
import pytest
from conftest import stage_of
from pinhole import rays

import dermis
from dermis.ies import ProfileError, parse

VERTICAL = np.array([0.0, 20.0, 45.0, 70.0, 90.0])
HORIZONTAL = np.array([0.0, 30.0, 90.0, 150.0, 200.0, 290.0, 360.0])
CANDELA = np.array(
    [
        [900.0, 700.0, 500.0, 300.0, 50.0],
        [900.0, 600.0, 800.0, 100.0, 20.0],
        [900.0, 1000.0, 300.0, 200.0, 90.0],
        [900.0, 400.0, 250.0, 350.0, 10.0],
        [900.0, 850.0, 600.0, 150.0, 60.0],
        [900.0, 300.0, 900.0, 250.0, 30.0],
        [900.0, 700.0, 500.0, 300.0, 50.0],
    ]
)


def text(
    vertical=VERTICAL, horizontal=HORIZONTAL, candela=CANDELA, kind=1, factors=(1.0, 1.0, 1.0), tilt="NONE"
):
    def line(values):
        return " ".join(f"{v:g}" for v in np.ravel(values))

    head = f"1 1000 {factors[0]} {len(vertical)} {len(horizontal)} {kind} 2 0 0 0\n{factors[1]} {factors[2]} 100\n"
    numbers = "\n".join(line(values) for values in (vertical, horizontal, candela))
    return f"IESNA:LM-63-2002\n[TEST] by hand\nTILT={tilt}\n{head}{numbers}\n"


def interpolated(theta, phi, vertical=VERTICAL, horizontal=HORIZONTAL, candela=CANDELA):
    """Candela at angles in degrees, bilinear, by numpy; nothing outside of the vertical angles."""
    rows = np.array([np.interp(np.ravel(theta), vertical, row, right=0.0) for row in candela])
    phi = np.clip(np.ravel(phi), horizontal[0], horizontal[-1])
    left = np.clip(np.searchsorted(horizontal, phi) - 1, 0, len(horizontal) - 2)
    part = (phi - horizontal[left]) / (horizontal[left + 1] - horizontal[left])
    at = np.arange(phi.size)
    values = (1.0 - part) * rows[left, at] + part * rows[left + 1, at]
    return np.reshape(values, np.shape(theta))


def test_the_file_is_read():
    profile = parse(text(factors=(2.0, 0.5, 0.9)))
    assert np.allclose(profile.vertical, VERTICAL) and np.allclose(profile.horizontal, HORIZONTAL)
    assert np.allclose(profile.candela, 0.9 * CANDELA)
    tilted = text().replace("TILT=NONE\n", "TILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8\n")
    assert np.allclose(parse(tilted).candela, CANDELA)
    assert np.allclose(parse(text().replace("TILT=NONE", "TILT=lamp.tlt")).candela, CANDELA)


@pytest.mark.parametrize(
    ("first", "last", "alike"),
    [
        (0, 90, lambda p: [p, 180 - p, 180 + p, 360 - p]),
        (0, 180, lambda p: [p, 360 - p]),
        (90, 270, lambda p: [p, (540 - p) % 360]),
    ],
)
def test_symmetries(first, last, alike):
    """What is measured of a part is the same in its mirror images."""
    angles = np.linspace(first, last, 7)
    candela = np.random.default_rng(4).uniform(10.0, 90.0, (7, 5))
    profile = parse(text(horizontal=angles, candela=candela))
    assert profile.horizontal[0] == 0.0 and profile.horizontal[-1] == 360.0
    assert (np.diff(profile.horizontal) > 0.0).all()
    for p in np.linspace(first, last, 13):
        expected = [np.interp(p, angles, candela[:, i]) for i in range(5)]
        for q in alike(p):
            got = [np.interp(q, profile.horizontal, profile.candela[:, i]) for i in range(5)]
            assert np.allclose(got, expected, rtol=1e-5), (p, q)


def test_a_seam_that_is_left_out_is_closed():
    profile = parse(text(horizontal=HORIZONTAL[:-1], candela=CANDELA[:-1]))
    assert np.allclose(profile.horizontal, HORIZONTAL) and np.allclose(profile.candela, CANDELA)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("no profile at all", "no line TILT="),
        (text(kind=2), "type B"),
        (text(kind=3), "type A"),
        (text()[:-40], "ends too early"),
        (text().replace("900", "nine", 1), "a number was expected"),
        (text(candela=-CANDELA), "negative"),
        (text(vertical=VERTICAL[::-1]), "vertical angles do not ascend"),
        (text(horizontal=HORIZONTAL / 9.0), "stands for no symmetry"),
    ],
)
def test_what_is_wrong_is_said(broken, words):
    with pytest.raises(ProfileError, match=words):
        parse(broken)


def test_a_light_without_its_file_shines_without_it(flat):
    body = (
        'def SphereLight "L" (prepend apiSchemas = ["ShapingAPI"])\n'
        "{ asset inputs:shaping:ies:file = @no.ies@\n }\n"
    )
    result = flat(body)
    assert "no.ies" in result.warnings[0][1] and "not found" in result.warnings[0][1]
    assert "ies" not in result.prims["/L"]["shaping"]


# Pictures: a white floor at z = 0 below a light at z = 1.5, seen by an orthographic camera from above.

SIZE, PIXELS, HEIGHT = 4.0, 16, 1.5
FLOOR = """
def Mesh "Floor" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)]
    uniform token subdivisionScheme = "none"
    rel material:binding = </White>
}
def Material "White"
{
    token outputs:mtlx:surface.connect = </White/S.outputs:out>
    def Shader "S"
    {
        uniform token info:id = "ND_open_pbr_surface_surfaceshader"
        color3f inputs:base_color = (1, 1, 1)
        float inputs:specular_weight = 0
        token outputs:out
    }
}
def Camera "Cam"
{
    token projection = "orthographic"
    float horizontalAperture = 40
    float verticalAperture = 40
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def floor(kind: str, lines: str, turn: float = 0.0, samples: int = 256) -> np.ndarray:
    light = f"""
def {kind} "Light" (prepend apiSchemas = ["ShapingAPI"])
{{
    float inputs:shaping:cone:angle = 180
    {lines}
    double3 xformOp:translate = (0, 0, {HEIGHT})
    float xformOp:rotateZ = {turn}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
}}
"""
    settings = {"resolution": (PIXELS, PIXELS), "samples": samples, "maxDepth": 0, "camera": "/Cam"}
    image = dermis.render(stage_of(FLOOR + light), aovs=[], **settings)
    assert image.stats["warnings"] == []
    return image.color[..., 0].astype(float)


def points() -> tuple[np.ndarray, np.ndarray]:
    x = (np.arange(PIXELS) + 0.5) / PIXELS * SIZE - SIZE / 2.0
    return np.meshgrid(x, -x)


@pytest.fixture
def profile(tmp_path):
    def written(**changes) -> str:
        file = tmp_path / "profile.ies"
        file.write_text(text(**changes))
        return f"asset inputs:shaping:ies:file = @{file}@\n"

    return written


SMALL = "float inputs:radius = 0.01\n float inputs:intensity = 100\n"


def angles(x, y, turn: float = 0.0):
    """Of directions from the light down to the floor; vertical ones from -Z, horizontal ones from +X to +Y."""
    theta = np.degrees(np.arctan2(np.hypot(x, y), HEIGHT))
    return theta, (np.degrees(np.arctan2(y, x)) - turn) % 360.0


@pytest.mark.parametrize("turn", [0.0, 65.0])
def test_a_small_light_by_its_angles(profile, turn):
    shaped = floor("SphereLight", SMALL + profile(), turn)
    ratio = shaped / floor("SphereLight", SMALL, turn)
    x, y = points()
    # Means over the tent of a pixel, of candela by what the floor receives.
    expected = tent_mean(lambda x, y: interpolated(*angles(x, y, turn)), x, y)
    assert np.abs(ratio / expected - 1.0).max() < 0.03
    assert abs(ratio.mean() / expected.mean() - 1.0) < 0.004


def tent_mean(value, x, y, n: int = 7):
    """Pixel filter: a tent of radius 1 pixel; the weight of what a point receives is cos^4."""
    t = (np.arange(2 * n) + 0.5) / n - 1.0
    weight = 1.0 - np.abs(t)
    total, sum_ = 0.0, 0.0
    for dx, wx in zip(t, weight, strict=True):
        for dy, wy in zip(t, weight, strict=True):
            at_x, at_y = x + dx * SIZE / PIXELS, y + dy * SIZE / PIXELS
            w = wx * wy / (at_x**2 + at_y**2 + HEIGHT**2) ** 2
            total = total + w * value(at_x, at_y)
            sum_ = sum_ + w
    return total / sum_


def test_angle_scale(profile):
    ratio = floor("SphereLight", SMALL + profile() + "float inputs:shaping:ies:angleScale = 1.5") / floor(
        "SphereLight", SMALL
    )
    x, y = points()

    def expected(x, y):
        theta, phi = angles(x, y)
        return interpolated(theta / 1.5, phi)

    assert abs(ratio.mean() / tent_mean(expected, x, y).mean() - 1.0) < 0.004


def test_normalize_divides_by_the_mean_over_what_is_measured(profile):
    """A hemisphere here; a sphere where the profile goes up to 180 degrees."""
    for vertical, steradians in ((VERTICAL, 2.0 * np.pi), (2.0 * VERTICAL, 4.0 * np.pi)):
        file = profile(vertical=vertical)
        plain = floor("SphereLight", SMALL + file)
        normalized = floor("SphereLight", SMALL + file + "bool inputs:shaping:ies:normalize = 1")
        theta, phi = (np.arange(720) + 0.5) * vertical[-1] / 720, (np.arange(720) + 0.5) / 2.0
        theta, phi = np.meshgrid(theta, phi, indexing="ij")
        sine = np.sin(np.radians(theta))
        cell = np.radians(vertical[-1] / 720) * np.radians(0.5)
        power = (interpolated(theta, phi, vertical) * sine).sum() * cell / steradians
        assert (normalized / plain).mean() == pytest.approx(1.0 / power, rel=1e-3)


def test_a_wide_light_by_quadrature(profile):
    """Every point of a rect light has the profile; the floor sums them."""
    body = "float inputs:width = 2\n float inputs:height = 1\n float inputs:intensity = 0.01\n"
    got = floor("RectLight", body + profile(), samples=1024)
    x, y = points()
    expected = np.zeros_like(x)
    u, v = (np.arange(24) + 0.5) / 24 - 0.5, (np.arange(12) + 0.5) / 12 - 0.5
    offsets = (np.arange(6) + 0.5) / 3.0 - 1.0
    for dx in offsets:
        for dy in offsets:
            w = (1.0 - abs(dx)) * (1.0 - abs(dy)) / 9.0
            for a in 2.0 * u:
                for b in v:
                    to_x, to_y = x + dx * SIZE / PIXELS - a, y + dy * SIZE / PIXELS - b
                    distance2 = to_x**2 + to_y**2 + HEIGHT**2
                    candela = interpolated(*angles(to_x, to_y))
                    expected += w * candela * HEIGHT**2 / distance2**2 * (2.0 / 24.0 / 12.0)
    expected *= 0.01 / np.pi
    assert abs(got.mean() / expected.mean() - 1.0) < 0.006
    assert np.abs(got / expected - 1.0).max() < 0.03


def test_our_stage(usd_scenes):
    """Wall and floor of usd_scenes/ies.usda by the inverse square law and numpy's interpolation of the file."""
    numbers = (usd_scenes / "downlight.ies").read_text().split("TILT=NONE")[1].split()[13:]
    vertical, horizontal = np.array(numbers[:10], float), np.array(numbers[10:15], float)
    candela = np.array(numbers[15:], float).reshape(5, 10)
    image = dermis.render(usd_scenes / "ies.usda", resolution=(64, 32), samples=64, maxDepth=0, aovs=[])
    assert image.stats["warnings"] == []
    sight = rays((64, 32), 30, 24, (0, 1.9, 9.2))
    p = sight.plane(2)
    floor = p[..., 1] < 0
    p[floor] = sight.plane(1)[floor]
    expected = np.zeros((32, 64))
    for x, intensity, scale in ((-2.4, 250.0, None), (0.0, 2.0, 1.0), (2.4, 2.0, 0.6)):
        way = p - np.array([x, 3.2, 0.5])
        distance2 = (way**2).sum(-1)
        cosine = np.where(floor, -way[..., 1], -way[..., 2]) / np.sqrt(distance2)
        shape = 1.0
        if scale:
            theta = np.degrees(np.arccos(-way[..., 1] / np.sqrt(distance2))) / scale
            # Half of the turn is measured; +Y of the light is the room's -Z.
            phi = np.abs(np.degrees(np.arctan2(-way[..., 2], way[..., 0])))
            shape = interpolated(theta, phi, vertical, horizontal, candela)
        expected += sight.mean(0.5 * intensity * 0.03**2 * cosine / distance2 * shape)
    got = image.color[..., 0].astype(float)
    assert got.mean() == pytest.approx(expected.mean(), rel=6e-3)
    blocks, known = (a.reshape(8, 4, 16, 4).mean((1, 3)) for a in (got, expected))
    lit = known > 0.02
    assert lit.sum() > 30 and np.abs(blocks[lit] / known[lit] - 1.0).max() < 0.06
