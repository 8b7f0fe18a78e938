"""Regular expressions by what is left of them, against Python's."""

import random
import re
from itertools import product

import pytest

from dermis.events import EMPTY, NOTHING, after, either, is_over, one, reached, repeated, sequence

WORDS = ["".join(word) for count in range(5) for word in product("abc", repeat=count)]


def made(dice: random.Random, depth: int) -> tuple[tuple, str]:
    """A pattern, and the same as Python writes it."""
    kind = dice.choice(("one", "sequence", "either", "repeated")) if depth else "one"
    if kind == "one":
        letters = dice.sample("abc", dice.randint(1, 3))
        return one(letters), f"[{''.join(letters)}]"
    if kind == "repeated":
        part, text = made(dice, depth - 1)
        least = dice.randint(0, 2)
        most = dice.choice((least, least + 1, least + 3, float("inf")))
        return repeated(part, least, most), f"(?:{text}){{{least},{'' if most == float('inf') else most}}}"
    parts = [made(dice, depth - 1) for _ in range(dice.randint(0, 3))]
    patterns, texts = [part for part, _ in parts], [text for _, text in parts]
    if kind == "sequence" or not parts:
        return sequence(patterns), "".join(f"(?:{text})" for text in texts)
    return either(patterns), f"(?:{'|'.join(texts)})"


@pytest.mark.parametrize("seed", range(60))
def test_takes_the_words_that_python_takes(seed):
    pattern, text = made(random.Random(seed), 4)
    for word in WORDS:
        left = pattern
        for letter in word:
            left = after(left, letter)
        assert is_over(left) == bool(re.fullmatch(text, word)), (text, word)


def test_nothing_follows_what_has_ended():
    assert after(EMPTY, "a") == NOTHING == after(NOTHING, "a") and not is_over(NOTHING) and is_over(EMPTY)
    assert sequence([one("a"), NOTHING]) == NOTHING and sequence([EMPTY, one("a")]) == one("a")
    assert repeated(one("a"), 2, 1) == NOTHING and repeated(one("a"), 0, 0) == EMPTY


def test_what_is_reached():
    count = sequence([one("a"), repeated(one("ab"), 3, 3)])
    assert EMPTY in reached({count}, "ab", 4) and EMPTY not in reached({count}, "ab", 3)
    with pytest.raises(ValueError, match="counts too much"):
        reached({sequence([repeated(one("ab"), 0, float("inf")), one("a"), *[one("ab")] * 30])}, "ab", 40)
