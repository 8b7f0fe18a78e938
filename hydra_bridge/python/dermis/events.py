"""Regular expressions over single letters, taken event by event: what is left of one after an event (Brzozowski 1964,
"Derivatives of regular expressions"). No text takes long, since equal remainders are one.

A pattern is a tuple: of the letters of an event, of parts in sequence, of choices, of a part that is repeated.
"""

from collections.abc import Iterable
from functools import lru_cache, reduce

Pattern = tuple

EMPTY: Pattern = ("then",)
"""The path without events."""
NOTHING: Pattern = ("either", frozenset())
"""No path."""


MOST = 2000
"""Events named in all that may follow paths of one length: above it nobody would read the expression."""


def one(letters: Iterable[str]) -> Pattern:
    return ("one", frozenset(letters))


def sequence(parts: list[Pattern]) -> Pattern:
    return reduce(lambda rest, part: then(part, rest), reversed(parts), EMPTY)


def then(first: Pattern, rest: Pattern) -> Pattern:
    if NOTHING in (first, rest):
        return NOTHING
    if EMPTY in (first, rest):
        return rest if first == EMPTY else first
    return ("then", first, rest)


def either(choices: Iterable[Pattern]) -> Pattern:
    found: set[Pattern] = set()
    for choice in choices:
        found.update(choice[1] if choice[0] == "either" else (choice,))
    return found.pop() if len(found) == 1 else ("either", frozenset(found))


def repeated(part: Pattern, least: int, most: float) -> Pattern:
    """`part` at least so many times, at most so many."""
    if most < least:
        return NOTHING
    return EMPTY if most == 0 or part == EMPTY else ("repeated", part, least, most)


@lru_cache(maxsize=1 << 16)
def is_over(pattern: Pattern) -> bool:
    """Whether it takes the path without events."""
    match pattern:
        case ("one", _):
            return False
        case ("either", choices):
            return any(map(is_over, choices))
        case ("repeated", part, least, _):
            return least == 0 or is_over(part)
        case _:
            return all(map(is_over, pattern[1:]))


@lru_cache(maxsize=1 << 16)
def after(pattern: Pattern, letter: str) -> Pattern:
    """What may follow `letter`."""
    match pattern:
        case ("one", letters):
            return EMPTY if letter in letters else NOTHING
        case ("either", choices):
            return either(after(choice, letter) for choice in choices)
        case ("repeated", part, least, most):
            return then(after(part, letter), repeated(part, max(least - 1, 0), most - 1))
        case ("then", first, rest):
            taken = then(after(first, letter), rest)
            return either((taken, after(rest, letter))) if is_over(first) else taken
        case _:
            return NOTHING  # after the empty path


def reached(patterns: set[Pattern], letters: str, depth: int) -> set[Pattern]:
    """What may follow up to `depth` of the `letters`, in any order. Raises ValueError where that is too much: counts
    within counts, or events counted from the end."""
    found, new = set(patterns), set(patterns)
    for _ in range(depth):
        new = {after(pattern, letter) for pattern in new for letter in letters} - found
        if not new:
            break
        found |= new
        if sum(map(size, new)) > MOST:
            raise ValueError("the expression counts too much")
    return found


@lru_cache(maxsize=1 << 16)
def size(pattern: Pattern) -> int:
    """Events that are named in it."""
    match pattern:
        case ("one", _):
            return 1
        case ("either", choices):
            return sum(map(size, choices))
        case ("repeated", part, _, _):
            return size(part)
        case _:
            return sum(map(size, pattern[1:]))
