"""Light path expressions as others write them: which sums of layers they are here."""

import time

import pytest

from dermis.aovs import CELLS, is_sum
from dermis.lpe import LONGEST, cells_of, parts_fog, parts_mirrors, sum_of
from dermis.products import named_lpe

OF_OTHERS = {
    # RenderMan: its documentation's table of per-channel expressions.
    "C[<L.>O]": "emission",
    "C<RD>[<L.>O]": "directDiffuse",
    "C<RD>[DS]+[<L.>O]": "indirectDiffuse",
    "C<RS>[<L.>O]": "directSpecular",
    "C<RS>[DS]+[<L.>O]": "indirectSpecular",
    "C<TD>.*[<L.>O]": "subsurface",
    "C<TS>.*[<L.>O]": "transmission",
    "CD2[<L.>O]": None,
    # Arnold's built-in ones.
    "C.*": "color",
    "C[DSV]L": "firstBounce",
    "C[DSV][DSVOB].*": "indirect+subsurface",
    "C[LO]": "emission",
    "C<RD>.*": "diffuse",
    "C<RD>L": "directDiffuse",
    "C<RD>[DSVOB].*": "indirectDiffuse",
    "C<TS>.*": "transmission",
    "C<TS>L": "directTransmission",
    "C<TS>[DSVOB].*": "indirectTransmission",
    "C<TD>.*": "subsurface",
    "CV.*": None,
    "CB": None,
    "C<RD>A": None,
    # Coats are not kept apart.
    "C<RS[^'coat']>.*": None,
    "C<RS'coat'>L": None,
    # Karma: G where others have S.
    "C<RD>.*L": "diffuse",
    "C<RD>.+L": "indirectDiffuse",
    "C<RG>L": "directSpecular",
    "C<RG>.+L": "indirectSpecular",
    "C<TG>.*[<L.><O>]": "transmission",
    "CL": "emission",
    "C.*O": None,
    "unoccluded;C<RD>.*L": None,
    # OSL.
    "C<R[GS]>.*[LO]": "specular",
    "C<T[GS]>.*[LO]": "transmission",
    "C<.[GS]>.*[LO]": "specular+transmission",
    "C(<RD>|<TD>).*[LO]": "diffuse+subsurface",
    "C<T'subsurface'>.*[LO]": "subsurface",
    'C<T"subsurface">.*[LO]': "subsurface",
    "C [^D] L": "directSpecular+directTransmission",
    "C.{0,1}[LO]": "direct",
    "C.{2,}[LO]": "indirect+subsurface",
    # Parts of what is kept apart.
    "C<RD>.{0,5}[LO]": None,
    "C<RD>.?.?.?.?.?[LO]": None,
    "C<RS>+[LO]": None,
    "C<RD>.*<L.'key'>": None,
    "C<RD>.*[^O]": "diffuse",
    # What is left out is not kept apart: lights of a group, labels of other renderers, fog, the background.
    "C.*<L.[^'key']>": None,
    "C.*<L.[^'coat']>": None,
    "C.*<L.[^'subsurface']>": None,
    "C<RS[^'clearcoat']>.*L": None,
    "C<RS[^'clearcoat''coat']>.*L": None,
    "C.*[^'key']": None,
    "C[^V].*[LO]": None,
    "C<[^V].>.*[LO]": None,
    "C.*[^B]": None,
    "C<T[^s]>.*L": None,
}


@pytest.mark.parametrize("text", OF_OTHERS)
def test_expressions_of_other_renderers(text):
    assert named_lpe(text) == OF_OTHERS[text]


@pytest.mark.parametrize(
    "text",
    ["", "L", "C[", "C<RD", "C'", "C*L", "C<RD>**", "C)", "C(", "C<RD'x>L", "Cz", "CD{" + "9" * 5000 + "}L"],
)
def test_what_is_no_expression(text):
    assert cells_of(text) == ()


@pytest.mark.parametrize("event", ["D", "S", "[DS]", "(D", "D*"])
def test_expressions_end_somewhere(event):
    """Patterns nest as deep as an expression is long, and are hashed on the C stack: that has killed the process."""
    for text in (f"C{event * 400_000}L", f"C{event * 1000}L"):
        assert (
            cells_of(text) == ()
            and named_lpe(text) is None
            and not parts_mirrors(text)
            and not parts_fog(text)
        )


def test_long_expressions_are_read():
    text = "C<RD>.*(" + "|".join(["L", "O"] * 240) + ")"
    assert 900 < len(text) <= LONGEST and named_lpe(text) == "diffuse"


def test_no_expression_takes_long():
    start = time.perf_counter()
    for text in (
        "C(.*)*B",
        "C.*.*.*.*.*.*B",
        "C((.+)+|D)+B",
        "C(.|.|.)*B",
        "C((D{0,9}S?){0,9}.?){0,99}L",
        "C.*D" + "." * 25 + "L",
        "C(D{1,1000}){1,1000}L",
    ):
        assert cells_of(text) == ()
    assert time.perf_counter() - start < 10.0


@pytest.mark.parametrize("text", [text for text, aov in OF_OTHERS.items() if aov])
def test_what_other_languages_keep_apart(text):
    """Mirrors: OSL has S for them, so that S alone, or G alone, is another thing there. Fog: V, which no letter but V
    and the dot takes; CVL is light that it scatters once."""
    mirrors = ("S" in text or "G" in text) and not any(
        word in text for word in ("[GS]", "C<RD>.", "C<TD>.", "C[LO]")
    )
    assert parts_mirrors(text) == mirrors
    late = {"C<RD>[DS]+[<L.>O]", "C<RS>[DS]+[<L.>O]", "C[DSV]L", "C[DSV][DSVOB].*", "C [^D] L"}
    whole = {"C.{0,1}[LO]", "C.{2,}[LO]", "C(<RD>|<TD>).*[LO]"}
    assert parts_fog(text) == (text in late | whole or text.startswith(("C<TD>", "C<T'", 'C<T"')))


def test_sums_have_the_fewest_names():
    assert sum_of(CELLS) == "direct+indirect+subsurface"
    assert all(sum_of((cell,)) == cell for cell in CELLS)
    assert is_sum("emission+diffuse") and not is_sum("diffuse+directDiffuse") and not is_sum("diffuse+albedo")
