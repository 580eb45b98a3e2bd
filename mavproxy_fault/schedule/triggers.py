"""Conditions on telemetry: a small expression language, parsed without evaluating Python.

    GLOBAL_POSITION_INT.relative_alt > 50000 and armed
    count(HIL_SENSOR) >= 1000 or HIL_ACTUATOR_CONTROLS.controls[3] > 0.9
    mode == "AUTO.MISSION" and abs(ATTITUDE.roll) < 0.1 and altitude_m > 20

A field means its newest value from the vehicle; a comparison with a message that has not arrived
yet is false. `mode` is PX4's name of the flight mode (other autopilots: the number in custom_mode).
The syntax is Python's, read by its parser; only the listed nodes of the syntax tree are accepted.
"""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.fault_parts.target import find_message
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

Value = float | int | str | bool | None

COMPARE: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    # A division by zero has no value, which makes the comparison false.
    ast.Div: lambda a, b: a / b if b else None,
    ast.BitAnd: lambda a, b: int(a) & int(b),
}
SIGN: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
# Chosen: longer than any hand-written condition; bounds the parser's time and depth.
LENGTH_MAX = 500
# Raised by Python's parser for hostile text.
_SYNTAX = (SyntaxError, RecursionError, MemoryError)

ARMED = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
PX4 = 12  # MAV_AUTOPILOT
NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: ground stations, cameras and the like
# PX4's custom_mode: main mode in bits 16 to 23, sub mode in bits 24 to 31 (px4_custom_mode.h).
PX4_MAIN = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED",
    8: "RATTITUDE", 9: "SIMPLE", 10: "TERMINATION", 11: "ALTITUDE CRUISE",
}  # fmt: skip
PX4_AUTO = {
    1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 7: "RTGS",
    8: "FOLLOW", 9: "PRECLAND", 10: "VTOL TAKEOFF", 19: "GUIDED COURSE", 20: "DESCEND",
}  # fmt: skip
FLIGHT_EVENTS = {"arming": "armed", "take-off": "armed and altitude_m > 0.5"}
FIRST_STAMP = "first-stamp"
ITEM = re.compile(r"mission-item:(\d+)")


class Telemetry:
    """The newest frame of each message, and the number received."""

    def __init__(self) -> None:
        self.newest: dict[int, Frame] = {}
        self.counts: dict[int, int] = {}

    def note(self, frame: Frame) -> None:
        """Store a frame; ignore heartbeats that are not from an autopilot."""
        # A ground station's heartbeat would make `armed` false.
        if frame.id == 0 and frame.number("autopilot") == NO_AUTOPILOT:
            return
        self.newest[frame.id] = frame
        self.counts[frame.id] = self.counts.get(frame.id, 0) + 1


class Condition:
    """A parsed expression; `ids` are the messages that it uses.

    Raises
    ------
    ValueError
        If the text is not a valid condition; the message says what is.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.ids: set[int] = set()
        if len(text) > LENGTH_MAX:
            raise ValueError(f"is longer than {LENGTH_MAX} characters; shorten it")
        try:
            self._root = self._part(ast.parse(text.strip(), mode="eval").body)
        except _SYNTAX as error:
            raise ValueError(
                f"= {text!r} cannot be read ({getattr(error, 'msg', error)}); "
                "write for example: HIL_GPS.alt > 500000 and armed"
            ) from None

    # Compared by text, so that a schedule read twice is equal.
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Condition) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def holds(self, telemetry: Telemetry) -> bool:
        """Whether the condition is true."""
        return bool(self._root(telemetry))

    def _part(self, node: ast.expr) -> Callable[[Telemetry], Value]:
        """Compile one node of the tree to a function."""
        # `bool` is an `int` in Python: True and False are numbers here.
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float | str):
            value = node.value
            return lambda telemetry: value
        if isinstance(node, ast.BoolOp):
            parts = [self._part(one) for one in node.values]
            join = all if isinstance(node.op, ast.And) else any
            return lambda telemetry: join(part(telemetry) for part in parts)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            part = self._part(node.operand)
            return lambda telemetry: not part(telemetry)
        if isinstance(node, ast.UnaryOp) and type(node.op) in SIGN:
            return self._of_number(SIGN[type(node.op)], node.operand)
        if isinstance(node, ast.Compare):
            return self._comparison(node)
        if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
            return self._both(ARITHMETIC[type(node.op)], node.left, node.right)
        if isinstance(node, ast.Call):
            return self._call(node)
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
            return self._name(node)
        raise ValueError(
            f"= {self.text!r} contains {ast.unparse(node)!r}, which is not allowed; "
            "use fields, numbers, and, or, not, comparisons, + - * / &, abs(), count()"
        )

    def _of_number(
        self, act: Callable[[Any], Any], argument: ast.expr
    ) -> Callable[[Telemetry], Value]:
        part = self._part(argument)

        def result(telemetry: Telemetry) -> Value:
            value = part(telemetry)
            return act(value) if isinstance(value, int | float) else None

        return result

    def _comparison(self, node: ast.Compare) -> Callable[[Telemetry], Value]:
        # `in` and `is` are not part of the language.
        if any(type(op) not in COMPARE for op in node.ops):
            raise ValueError(f"= {self.text!r}: has another comparison; use == != < <= > >=")
        sides = [node.left, *node.comparators]
        steps = [
            self._both(COMPARE[type(op)], left, right)
            for op, left, right in zip(node.ops, sides, sides[1:], strict=False)
        ]
        return lambda telemetry: all(step(telemetry) for step in steps)

    def _both(
        self, act: Callable[[Any, Any], Any], left: ast.expr, right: ast.expr
    ) -> Callable[[Telemetry], Value]:
        one, two = self._part(left), self._part(right)

        def joined(telemetry: Telemetry) -> Value:
            a, b = one(telemetry), two(telemetry)
            # Text compares with text only; anything else is undefined and so false.
            if a is None or b is None or isinstance(a, str) != isinstance(b, str):
                return None
            found: Value = act(a, b)
            return found

        return joined

    def _call(self, node: ast.Call) -> Callable[[Telemetry], Value]:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if len(node.args) != 1 or node.keywords or name not in ("abs", "count"):
            raise ValueError(f"= {self.text!r} calls {ast.unparse(node)!r}; use abs() or count()")
        argument = node.args[0]
        if name == "count":
            if not isinstance(argument, ast.Name):
                raise ValueError(f"= {self.text!r}: count() needs the name of a message")
            number = find_message(argument.id).id
            self.ids.add(number)
            return lambda telemetry: telemetry.counts.get(number, 0)
        return self._of_number(abs, argument)

    def _name(self, node: ast.expr) -> Callable[[Telemetry], Value]:
        """Compile a keyword, MESSAGE.field, or MESSAGE.field[3]."""
        index = 0
        if isinstance(node, ast.Subscript):
            if not isinstance(node.slice, ast.Constant) or not isinstance(node.slice.value, int):
                raise ValueError(f"= {self.text!r}: an index must be a number")
            index, node = node.slice.value, node.value
        if isinstance(node, ast.Name):
            return self._keyword(node.id)
        if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
            raise ValueError(f"= {self.text!r}: {ast.unparse(node)} is not MESSAGE.field; give one")
        layout = find_message(node.value.id)
        field = layout.fields.get(node.attr)
        # Only numeric fields, with an index within the message's definition.
        if field is None or field.type == "char" or not 0 <= index < max(field.count, 1):
            raise ValueError(
                f"= {self.text!r}: {layout.name} has no number {node.attr}[{index}]; "
                f"{suggest_known(node.attr, layout.fields)}"
            )
        name = field.name
        return self._of_newest(layout.id, lambda frame: frame.number(name, index))

    def _keyword(self, keyword: str) -> Callable[[Telemetry], Value]:
        if keyword not in KEYWORDS:
            raise ValueError(
                f"= {self.text!r}: {keyword} is unknown; words are {', '.join(KEYWORDS)}"
            )
        message, meaning = KEYWORDS[keyword]
        return self._of_newest(message_layout(message).id, meaning)

    def _of_newest(
        self, number: int, meaning: Callable[[Frame], Value]
    ) -> Callable[[Telemetry], Value]:
        """Compile what the newest frame of a message means."""
        self.ids.add(number)

        def read(telemetry: Telemetry) -> Value:
            frame = telemetry.newest.get(number)
            # Unknown until the message arrives.
            return None if frame is None else meaning(frame)

        return read


def is_armed(heartbeat: Frame) -> bool:
    """Whether a heartbeat reports the vehicle as armed."""
    return bool(int(heartbeat.number("base_mode")) & ARMED)


def flight_mode(heartbeat: Frame) -> str | int:
    """Return the name of PX4's flight mode, or the number of another autopilot's."""
    number = int(heartbeat.number("custom_mode"))
    if heartbeat.number("autopilot") != PX4:
        return number
    main, sub = number >> 16 & 0xFF, number >> 24 & 0xFF
    name = PX4_MAIN.get(main, str(main))
    return f"AUTO.{PX4_AUTO[sub]}" if name == "AUTO" and sub in PX4_AUTO else name


def altitude_m(position: Frame) -> float:
    """Return the height above home [m]."""
    return position.number("relative_alt") / 1000.0


KEYWORDS: Mapping[str, tuple[str, Callable[[Frame], Value]]] = {
    "armed": ("HEARTBEAT", is_armed),
    "mode": ("HEARTBEAT", flight_mode),
    "altitude_m": ("GLOBAL_POSITION_INT", altitude_m),
}


def event_condition(text: str) -> Condition | None:
    """Return the condition for a flight event; None for the first timestamp, which needs none.

    Raises
    ------
    ValueError
        If the event does not exist.
    """
    if text == FIRST_STAMP:
        return None
    if item := ITEM.fullmatch(text):
        return Condition(f"MISSION_ITEM_REACHED.seq >= {item[1]}")
    if text not in FLIGHT_EVENTS:
        raise ValueError(
            f"= {text} is not a flight event; give {FIRST_STAMP}, "
            f"{', '.join(FLIGHT_EVENTS)} or mission-item:N"
        )
    return Condition(FLIGHT_EVENTS[text])
