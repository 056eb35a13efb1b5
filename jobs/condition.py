"""Conditions over the parameters of a cell: "alpha_x <= alpha_y and metal in ['Au', 'Cu']".

    condition  = and-ed and or-ed comparisons, `not`, parentheses
    comparison = value (< <= > >= == != value)..., value [not] in [value, ...]
    value      = number, 'text', true, false, null, name of an axis, + - * / of numbers

A name with other than letters, digits and _ stands in backticks: `coat alpha`. Numbers that agree
to nine digits are equal, so that 0.1 + 0.2 == 0.3; whole numbers only if they are the same. A
parameter that a cell does not have is null; null is smaller, larger than nothing. Nothing of Python
is reached: texts become closures over the operators of this file.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MAX_LENGTH = 500
MAX_DEPTH = 20
SAME = 1e-9  # relative difference up to which two numbers are one

Get = Callable[[str], Any]
Node = Callable[[Get], Any]

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<text>'[^']*'|\"[^\"]*\")"
    r"|(?P<name>[^\W\d]\w*)|`(?P<quoted>[^`]+)`|(?P<sign><=|>=|==|!=|[-<>+*/()\[\],]))"
)
_WORDS = {"true": True, "false": False, "null": None}
_KEYWORDS = {"and", "or", "not", "in", *_WORDS}
_ORDER = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_ARITHMETIC = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv
}  # fmt: skip


class ConditionError(ValueError):
    """A condition cannot be read, or makes no sense for the values of a cell."""


@dataclass(frozen=True)
class Condition:
    """A condition that was read; call it with a function from name to value."""

    text: str
    names: tuple[str, ...]
    _node: Node

    def __call__(self, get: Get) -> bool:
        """Tell whether the condition holds. Raises ConditionError, e.g. for 'Au' < 0.1."""
        return _truth(self._node(get))


def parse_condition(text: Any) -> Condition:
    """Read a condition. Raises ConditionError that says what is wrong and where."""
    if not isinstance(text, str) or not text.strip():
        raise ConditionError("a condition is a text such as 'alpha_x <= alpha_y'")
    if len(text) > MAX_LENGTH:
        raise ConditionError(f"a condition has at most {MAX_LENGTH} characters, not {len(text)}")
    parser = _Parser(text)
    node = parser.either(0)
    parser.end()
    return Condition(text, tuple(dict.fromkeys(parser.names)), node)


# -- reading ------------------------------------------------------------------------------------
class _Parser:
    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0
        self.names: list[str] = []
        self._kind, self._token = "", ""
        self._next()

    def _next(self) -> None:
        rest = self._text[self._at :]
        if not rest.strip():
            self._kind = self._token = ""
            self._at = len(self._text)
            return
        match = _TOKEN.match(rest)
        if match is None or match.lastgroup is None:
            start = self._at + len(rest) - len(rest.lstrip())
            bad = self._text[start]
            hint = "; 'equal' is ==" if bad == "=" else ""
            raise ConditionError(f"{bad!r} at character {start + 1} means nothing here{hint}")
        self._kind, self._token = match.lastgroup, match[match.lastgroup]
        if self._kind == "name" and self._token in _KEYWORDS:
            self._kind = "word"
        self._at += match.end()

    def _take(self, *tokens: str) -> str:
        """Consume the current token if it is one of `tokens`; return it or nothing."""
        token = self._token
        if self._kind in ("sign", "word") and token in tokens:
            self._next()
            return token
        return ""

    def _need(self, token: str) -> None:
        if not self._take(token):
            raise self._unexpected(f"{token!r} is missing")

    def _unexpected(self, what: str) -> ConditionError:
        before = f"before {self._token!r}" if self._token else "at the end"
        return ConditionError(f"{what} {before} of {self._text!r}" if not self._token
                              else f"{what} {before} in {self._text!r}")  # fmt: skip

    def end(self) -> None:
        if self._token:
            raise self._unexpected("an operator is missing")

    def either(self, depth: int) -> Node:
        if depth > MAX_DEPTH:
            raise ConditionError(f"a condition is nested at most {MAX_DEPTH} deep")
        nodes = [self._both(depth)]
        while self._take("or"):
            nodes.append(self._both(depth))
        return nodes[0] if len(nodes) == 1 else lambda get: any(_truth(n(get)) for n in nodes)

    def _both(self, depth: int) -> Node:
        nodes = [self._negated(depth)]
        while self._take("and"):
            nodes.append(self._negated(depth))
        return nodes[0] if len(nodes) == 1 else lambda get: all(_truth(n(get)) for n in nodes)

    def _negated(self, depth: int) -> Node:
        turns = 0
        while self._take("not"):
            turns += 1
        node = self._comparison(depth)
        if not turns:
            return node
        return lambda get: _truth(node(get)) ^ bool(turns % 2)

    def _comparison(self, depth: int) -> Node:
        first = self._sum(depth)
        steps: list[tuple[Callable[[Any, Any], bool], Node]] = []
        while True:
            if sign := self._take("<", "<=", ">", ">=", "==", "!="):
                steps.append((_COMPARE[sign], self._sum(depth)))
            elif self._take("in"):
                steps.append((_within, self._choices(depth)))
            elif self._kind == "word" and self._token == "not":
                self._next()
                self._need("in")
                steps.append((lambda a, b: not _within(a, b), self._choices(depth)))
            else:
                break
        return _chain(first, steps) if steps else first

    def _choices(self, depth: int) -> Node:
        self._need("[")
        nodes = [self._sum(depth)]
        while self._take(","):
            nodes.append(self._sum(depth))
        self._need("]")
        return lambda get: [n(get) for n in nodes]

    def _sum(self, depth: int) -> Node:
        node = self._product(depth)
        while sign := self._take("+", "-"):
            node = _calculation(sign, node, self._product(depth))
        return node

    def _product(self, depth: int) -> Node:
        node = self._signed(depth)
        while sign := self._take("*", "/"):
            node = _calculation(sign, node, self._signed(depth))
        return node

    def _signed(self, depth: int) -> Node:
        negative = False
        while sign := self._take("-", "+"):
            negative ^= sign == "-"
        node = self._atom(depth)
        return _calculation("-", lambda get: 0, node) if negative else node

    def _atom(self, depth: int) -> Node:
        if self._take("("):
            node = self.either(depth + 1)
            self._need(")")
            return node
        kind, token = self._kind, self._token
        if kind in ("name", "quoted"):
            self._next()
            self.names.append(token)
            return lambda get: get(token)
        if kind == "number" or kind == "text" or token in _WORDS:
            value = _constant(kind, token)
            self._next()
            return lambda get: value
        raise self._unexpected("a value is missing")


def _constant(kind: str, token: str) -> Any:
    if kind == "text":
        return token[1:-1]
    if kind == "word":
        return _WORDS[token]
    value = float(token)
    if math.isinf(value):
        raise ConditionError(f"the number {token} is too large")
    return int(token) if token.isdigit() else value


# -- meaning ------------------------------------------------------------------------------------
def _truth(value: Any) -> bool:
    if value is None:
        return False
    if not isinstance(value, bool):
        raise ConditionError(
            f"{_shown(value)} is neither true nor false; compare it with something"
        )
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def equal(a: Any, b: Any) -> bool:
    """Tell whether two values are the same; whole numbers exactly, others to nine digits."""
    if not (_is_number(a) and _is_number(b)):
        return type(a) is type(b) and bool(a == b)
    if a == b or (isinstance(a, int) and isinstance(b, int)):
        return bool(a == b)
    try:
        return math.isclose(a, b, rel_tol=SAME, abs_tol=0.0)
    except OverflowError:  # a whole number beyond all floats
        return False


def _ordered(sign: str) -> Callable[[Any, Any], bool]:
    strict = sign in "<>"

    def compare(a: Any, b: Any) -> bool:
        if a is None or b is None:
            return False
        if not (_is_number(a) and _is_number(b)) and not (type(a) is type(b) is str):
            raise ConditionError(f"{_shown(a)} {sign} {_shown(b)}: only numbers have an order")
        if equal(a, b):
            return not strict
        return bool(_ORDER[sign](a, b))

    return compare


def _within(value: Any, choices: Any) -> bool:
    return any(equal(value, choice) for choice in choices)


_COMPARE: dict[str, Callable[[Any, Any], bool]] = {
    **{sign: _ordered(sign) for sign in _ORDER},
    "==": equal,
    "!=": lambda a, b: not equal(a, b),
}


def _chain(first: Node, steps: list[tuple[Callable[[Any, Any], bool], Node]]) -> Node:
    def chain(get: Get) -> bool:
        left = first(get)
        for compare, node in steps:
            right = node(get)
            if not compare(left, right):
                return False
            left = right
        return True

    return chain


def _calculation(sign: str, left: Node, right: Node) -> Node:
    def calculate(get: Get) -> Any:
        a, b = left(get), right(get)
        if a is None or b is None:
            return None
        if not (_is_number(a) and _is_number(b)):
            raise ConditionError(
                f"{_shown(a)} {sign} {_shown(b)}: only numbers can be reckoned with"
            )
        try:
            result = _ARITHMETIC[sign](float(a), float(b))
        except ZeroDivisionError:
            raise ConditionError(f"{_shown(a)} / {_shown(b)} divides by zero") from None
        except OverflowError:
            result = math.inf
        if not math.isfinite(result):
            raise ConditionError(f"{_shown(a)} {sign} {_shown(b)} is too large a number")
        return result

    return calculate


def _shown(value: Any) -> str:
    if not _is_number(value):
        return repr(value)
    return f"{value:.6g}" if abs(value) < 1e300 else "a number above 1e300"
