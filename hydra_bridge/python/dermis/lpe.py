"""Light path expressions: which of the parts that the beauty falls into an expression means.

An expression is a regular expression over events, from the camera to the light (OSL's language, as RenderMan,
Arnold and Karma have it). It is asked about paths of each part: an expression that takes all of a part or nothing of
it, in every part, is a sum of parts.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from .aovs import CELLS, SUMS
from .events import Pattern, after, either, is_over, one, reached, repeated, sequence

EVENTS = {
    "d": ("R", "D", ""),
    "g": ("R", "G", ""),
    "c": ("R", "G", "coat"),
    "t": ("T", "G", ""),
    "r": ("R", "S", ""),
    "k": ("R", "S", "coat"),
    "u": ("T", "S", ""),
    "b": ("T", "D", "subsurface"),
    "v": ("V", "", ""),
    "L": ("L", "", ""),
    "l": ("L", "", "coat"),
    "m": ("L", "", "subsurface"),
    "O": ("O", "", ""),
    "B": ("B", "", ""),
}
"""Events by a letter of their own: type, scattering, label. Coats are not kept apart: an expression that leaves them
out is none of dermis'. S and G are one, as RenderMan and Arnold have S alone, Karma G alone; to OSL, which has both, S
is mirrors. A group of lights may have the label of a lobe."""

LABELS = ("coat", "subsurface")
"""Of lobes."""

NOT_APART = (("V", "", ""), ("B", "", ""), ("", "s", ""))
"""Fog, the background, straight ways: in layers of dermis together with others, so that none is without them."""

FIRST = {"Diffuse": "d", "Specular": "gc", "Transmission": "t", "subsurface": "b"}
"""First events of the parts of a lobe, and of what media scatter."""

LATER = "dgctb"
MIRRORS = {"g": "gr", "c": "ck", "t": "tu"}
"""What these events are in OSL's language."""
VOLUME = "v"
FOG = {"b": f"b{VOLUME}"}
"""What a medium scatters has come by V where the medium is fog, which light gets into and out of without an event."""

LONGEST = 1000
"""Characters of an expression that is read: patterns nest as deep as it is long, Python's C stack ends."""

LONG = 40
"""Later events of the longest paths that are asked about: more than any expression counts."""

COUNT = re.compile(r"[*+?]|\{(\d*)(,?)(\d*)\}")


class NotRead(ValueError):
    """An expression of another language."""


@cache
def cells_of(text: str) -> tuple[str, ...]:
    """Parts of the beauty that `text` means together; none where it means something that dermis does not keep apart."""
    found = answers_of(text)
    if any(len(answers) > 1 for answers in found.values()):
        return ()
    return tuple(cell for cell, answers in found.items() if answers == {True})


@cache
def parts_mirrors(text: str) -> bool:
    """Whether OSL, to which glossy (G) and mirrors (S) are two things, takes `text` for something else than dermis."""
    return answers_of(text) != answers_of(text, MIRRORS, apart=True)


@cache
def parts_fog(text: str) -> bool:
    """Whether `text` means something else where fog is V than to dermis, where it is a medium like others."""
    return answers_of(text) != answers_of(text, FOG)


def letters_of(text: str) -> set[str]:
    """Letters of an expression, those of labels left out."""
    return set(re.sub(r"'[^']*'", "", text.replace('"', "'")))


def answers_of(text: str, finer: dict[str, str] | None = None, apart: bool = False) -> dict[str, set[bool]]:
    """What `text` answers about paths of each part; nothing where it is no expression, or too long a one. `finer`:
    events that are of several kinds; `apart`: S and G are two things."""
    if len(text) > LONGEST:
        return {}
    try:
        pattern = Reader(re.sub(r"\s+", "", text).replace('"', "'"), apart).pattern()
        return {cell: answers_about(pattern, cell, finer or {}) for cell in CELLS}
    except (ValueError, RecursionError):  # NotRead, and counts of thousands of digits
        return {}


def answers_about(pattern: Pattern, cell: str, finer: dict[str, str]) -> set[bool]:
    """Whether it takes paths of a part. They end on lights: what glows is one."""
    return {is_over(after(rest, light)) for rest in after_ways(pattern, cell, finer) for light in "Llm"}


def after_ways(pattern: Pattern, cell: str, finer: dict[str, str]) -> set[Pattern]:
    """What the ways of a part from the camera to a light leave of a pattern."""
    if cell == "emission":
        return {pattern}
    lobe = cell.removeprefix("direct").removeprefix("indirect")
    firsts = {after(pattern, kind) for event in FIRST[lobe] for kind in finer.get(event, event)}
    if cell.startswith("direct"):
        return firsts
    later = "".join(finer.get(event, event) for event in LATER)
    # Of media entry and exit at least: RenderMan counts it so, too.
    seconds = {after(first, kind) for first in firsts for kind in later}
    scattered = (
        {after(pattern, VOLUME)}
        if VOLUME in "".join(finer.get(event, "") for event in FIRST[lobe])
        else set()
    )
    return reached(seconds, later, LONG) | scattered


def sum_of(cells: tuple[str, ...]) -> str:
    """The name of an AOV that is the sum of parts: as few names as may be."""
    left, names = set(cells), []
    for name, parts in sorted(SUMS.items(), key=lambda item: -len(item[1])):
        if left.issuperset(parts):
            names.append(name)
            left.difference_update(parts)
    return "+".join(names)


Test = Callable[[tuple[str, str, str]], bool]


@dataclass
class Reader:
    """Reads an expression over EVENTS, the camera left out; `apart`: S is mirrors, G what is glossy."""

    text: str
    apart: bool = False
    at: int = 0

    def pattern(self) -> Pattern:
        if not (self.taken("C") or self.taken("<C.>") or self.taken("<C>")):
            raise NotRead(self.text)
        pattern = self.choices()
        if self.at < len(self.text):
            raise NotRead(self.text)
        return pattern

    def taken(self, word: str) -> bool:
        found = self.text.startswith(word, self.at)
        self.at += len(word) if found else 0
        return found

    def next(self) -> str:
        if self.at >= len(self.text):
            raise NotRead(self.text)
        self.at += 1
        return self.text[self.at - 1]

    def choices(self) -> Pattern:
        choices: list[list[Pattern]] = [[]]
        while self.at < len(self.text) and self.text[self.at] != ")":
            if self.taken("|"):
                choices.append([])
            else:
                choices[-1].append(self.counted())
        return either([sequence(parts) for parts in choices])

    def counted(self) -> Pattern:
        """An event or a group, with how often it comes."""
        if self.taken("("):
            part = self.choices()
            if not self.taken(")"):
                raise NotRead(self.text)
        else:
            test = self.event()
            part = one(letter for letter, event in EVENTS.items() if test(event))
        count = COUNT.match(self.text, self.at)
        if not count:
            return part
        self.at = count.end()
        if count[0] in ("*", "+", "?"):
            return repeated(part, int(count[0] == "+"), 1 if count[0] == "?" else math.inf)
        least, open_ended, most = count.groups()
        if not least and not most:
            raise NotRead(self.text)
        top = int(most) if most else math.inf if open_ended else int(least)
        return repeated(part, int(least or 0), top)

    def event(self) -> Test:
        """One event: a letter, a label, a set of events, or type, scattering and labels in angles."""
        if self.taken("["):
            return self.members(self.event)
        if self.taken("<"):
            tests = []
            while not self.taken(">"):
                tests.append(self.field(len(tests)))
            return lambda event: all(test(event) for test in tests)
        if self.text.startswith("'", self.at):
            return self.field(2)
        letter = self.next()
        place = next((i for i, known in enumerate(("RTVLOBA", "DGSs")) if letter in known), None)
        if letter == ".":
            return lambda event: True
        if place is None:
            raise NotRead(self.text)
        return self.has(letter, place)

    def members(self, member: Callable[[], Test]) -> Test:
        """What is left of a set in brackets: one of its members, or with ^ none of them."""
        inverse, tests = self.taken("^"), []
        while not self.taken("]"):
            tests.append(member())
        if inverse and any(test(event) for test in tests for event in NOT_APART):
            raise NotRead(self.text)
        return lambda event: any(test(event) for test in tests) != inverse

    def field(self, place: int) -> Test:
        """What an event in angles has in `place`, or its label, which may come early."""
        if self.taken("["):
            return self.members(lambda: self.field(place))
        if self.taken("'"):
            end = self.text.find("'", self.at)
            if end < 0:
                raise NotRead(self.text)
            label, self.at = self.text[self.at : end], end + 1
            if label not in LABELS:
                raise NotRead(self.text)
            return self.has(label, 2)
        letter = self.next()
        if letter == ".":
            return lambda event: True
        if place > 1 or letter not in ("RTVLOBA", "DGSs")[place]:
            raise NotRead(self.text)
        return self.has(letter, place)

    def has(self, word: str, place: int) -> Test:
        words = ("G", "S") if place == 1 and word in "GS" and not self.apart else (word,)
        return lambda event: event[place] in words
