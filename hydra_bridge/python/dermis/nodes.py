"""A node of a shading network as its handlers see it, and what the handlers of several libraries share."""

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from .network import Network, Value, constant

ZERO, ONE, HALF = constant(0.0), constant(1.0), constant(0.5)

TINY = constant(1e-8)
"""MaterialX's M_FLOAT_EPS: what it takes for zero."""


class Node(Protocol):
    """A node of the stage, one of its outputs asked for."""

    network: Network
    identifier: str
    category: str
    output: str
    width: int
    is_color: bool

    def get(self, name: str, default: Value) -> Value:
        """An input, driven or not."""
        ...

    def token(self, name: str, default: str) -> str:
        """An input that is a word."""
        ...

    def number(self, name: str, default: float) -> float:
        """An input that must be constant."""
        ...

    def matrix(self, name: str) -> list[list[float]] | None:
        """The rows of an input that is a constant matrix; None where there is none."""
        ...

    def warn(self, name: str, message: str) -> None:
        """Something to say of an input."""
        ...

    def has(self, name: str) -> bool:
        """Whether an input is authored or connected."""
        ...

    def image(self, file: str, space: str, node: dict[str, Any]) -> dict[str, Any]:
        """The node with its tiles, from the file of an input."""
        ...


Handler = Callable[[Node], Value]


def chosen(node: Node, name: str, default: str, words: Iterable[str]) -> str:
    """One of `words`; the default, with a warning, where the input says something else."""
    word = node.token(name, default)
    if word in words:
        return word
    node.warn(name, f"'{word}' is none of {', '.join(words)}; '{default}' is used")
    return default


def default_st(node: Node) -> Value:
    return node.network.primvar(2, "st", constant((0.0, 0.0)))


def read_primvar(node: Node, name: str, fallback: Value) -> Value:
    value = node.network.primvar(node.width, name, fallback)
    # A mesh may have more components than the reader wants.
    return node.network.gather((value, 0)) if node.width == 1 else value
