"""Universal Robots' URScript: movej with joint lists and blend radii, and servoj.

movej moves linearly in the joints, and blends within a radius around the TCP. servoj follows its inputs with a lag that
`lookahead_time` and `gain` set; its motion is read as linear between configurations. Source: the script manual of
Universal Robots, module motion.
"""

import ast
import operator
import re
from typing import Any, NamedTuple

import numpy as np

from htcp_jax.io.motions.source import DEG, LARGEST, Rows, Source, corners, elapsed, listed

ARGUMENTS = {  # names in order, of those that are used or skipped
    "movej": ("q", "a", "v", "t", "r"),
    "servoj": ("q", "a", "v", "t", "lookahead_time", "gain"),
}
SERVO_S = 0.002  # default of servoj's argument t
STILL = {
    "stopj", "sleep", "sync", "textmsg", "popup", "set_tcp", "set_payload", "set_payload_mass", "set_payload_cog",
    "set_target_payload", "set_gravity", "set_digital_out", "set_standard_digital_out", "set_configurable_digital_out",
    "set_tool_digital_out", "set_analog_out", "set_standard_analog_out", "set_tool_voltage", "set_tool_communication",
    "set_flag", "set_safety_mode_transition_hardness", "reset_world_model", "modbus_set_output_register",
    "modbus_set_output_signal", "socket_open", "socket_close", "socket_send_string", "write_output_integer_register",
    "write_output_float_register", "write_output_boolean_register", "set_standard_analog_input_domain",
    "set_tool_analog_input_domain", "set_analog_outputdomain", "set_input_actions_to_default",
}  # fmt: skip
MOVES = {
    "movel", "movep", "movec", "servoc", "servol", "speedj", "speedl", "force_mode", "freedrive_mode", "teach_mode",
    "track_conveyor_linear", "track_conveyor_circular", "path_offset_set", "direct_torque", "stopl", "optimovej",
    "optimovel",
}  # fmt: skip
FLOW = {"if", "elif", "else", "while", "for", "thread", "return", "break", "continue", "run", "join", "kill", "halt",
        "enter_critical", "exit_critical"}  # fmt: skip
OPERATIONS: dict[type, Any] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv
}  # fmt: skip
Value = list[float] | float | None
NAME = r"[A-Za-z_]\w*"
CALL = re.compile(rf"({NAME})\s*\((.*)\)", re.DOTALL)
ASSIGNMENT = re.compile(rf"(?:global\s+|local\s+)?({NAME})\s*=(?!=)\s*(.*)", re.DOTALL)
FROM_HERE = "The motion to the first configuration is not in the file."


class _Line(NamedTuple):
    line: int
    text: str
    function: str  # "" outside of functions


class _Move(NamedTuple):
    line: int
    q: list[float]  # [rad]
    time_s: float | None
    radius_m: float
    servo: bool


def read_urscript(source: Source) -> Rows:
    """Return the configurations of a script's movej and servoj commands.

    Raises:
        InputError: For other commands that move, control flow, calls of unknown functions, a function that is called
            more than once, and lists that are not plain numbers.
    """
    source.check_unit("URScript", "rad")
    source.check_uncoupled("urscript")
    robot, moves, still = source.robot, [], set()
    known: dict[str, Value] = {}
    for each in _executed(source):
        text = each.text
        if (called := CALL.fullmatch(text)) is not None:
            name, inside = called.groups()
            if not _is_call(text):
                source.fail(each.line, f"{text[:60]!r} is not one call")
            if name in ARGUMENTS:
                moves.append(_move(source, each.line, name, inside, known))
            elif name in STILL or name.endswith("_signal_on"):
                still.add(name)
            elif name in MOVES:
                source.fail(each.line, f"{name} moves in a way that cannot be read; only movej and servoj are")
            else:
                source.fail(each.line, f"{name} is not known, it may move; only movej and servoj can be read")
        elif (assigned := ASSIGNMENT.fullmatch(text)) is not None:
            name, value = assigned.groups()
            if (inner := CALL.fullmatch(value.strip())) is not None and inner[1] in MOVES | ARGUMENTS.keys():
                source.fail(each.line, f"{inner[1]} in an assignment cannot be read")
            known[name] = _value(value, known)
        else:
            source.fail(each.line, f"{text[:40]!r} cannot be read; only movej and servoj can be")
    for move in moves:
        if len(move.q) != robot.dof:
            source.fail(
                move.line, f"{len(move.q)} values; {robot.name} has {robot.dof} joints: {listed(robot.joint_names)}"
            )
    radii = [move.radius_m for move in moves]
    if radii:
        radii[0] = radii[-1] = 0.0  # nothing is cut at the ends
    notes = ["URScript: movej moves linearly in the joints; blend radii are around the TCP.", FROM_HERE]
    if any(move.servo for move in moves):
        notes.append(
            "servoj: linear between configurations; the controller's lag is not in the file, see tracking_rad."
        )
    if still:
        notes.append(f"Commands that do not move are not read: {listed(sorted(still))}.")
    return Rows(
        robot.joint_names,
        np.array([move.q for move in moves]) if moves else np.zeros((0, robot.dof)),
        np.array([move.line for move in moves], int),
        time_s=elapsed([move.time_s for move in moves]),
        corner_m=corners(radii),
        notes=tuple(notes),
    )


def _executed(source: Source) -> list[_Line]:
    """Return the lines in the order in which they run: the only function that moves stands for its call."""
    every = _lines(source)
    top = [each for each in every if not each.function]
    bodies: dict[str, list[_Line]] = {}
    for each in every:
        if each.function:
            bodies.setdefault(each.function, []).append(each)
    calls = {
        name: [k for k, each in enumerate(top) if re.fullmatch(rf"{name}\s*\(\s*\)", each.text)] for name in bodies
    }
    for name, body in bodies.items():
        for each in body:
            called = CALL.fullmatch(each.text)
            if called is not None and called[1] in bodies:
                source.fail(each.line, f"a call of {called[1]} in {name}; valid: calls outside of functions")
        if len(calls[name]) > 1:
            source.fail(top[calls[name][1]].line, f"a second call of {name}; valid: one")
    uncalled = [name for name in bodies if not calls[name]]
    if len(bodies) == 1 and uncalled and not top:  # as sent to the controller, which calls it
        return bodies[uncalled[0]]
    if uncalled:
        source.fail(bodies[uncalled[0]][0].line, f"the function {uncalled[0]} is not called")
    result = []
    for each in top:
        name = _word(each.text)
        result += bodies[name] if name in bodies else [each]
    return result


def _lines(source: Source) -> list[_Line]:
    """Return the script's lines without comments; a list may continue on the next line."""
    found, function, text, begin = [], "", "", 1
    for number, full in enumerate(source.text.splitlines(), start=1):
        plain = re.sub(r'"[^"]*"', '""', full).partition("#")[0].strip()
        begin = begin if text else number
        text = f"{text} {plain}".strip()
        if not text or sum(map(text.count, "([")) > sum(map(text.count, ")]")):
            continue
        if (word := _word(text)) in FLOW:
            source.fail(begin, f"{word} controls the flow, which cannot be read")
        if (defined := re.fullmatch(rf"def\s+({NAME})\s*\(\s*\)\s*:", text)) is not None:
            if function:
                source.fail(begin, f"a function in the function {function} cannot be read")
            function = defined[1]
        elif text.startswith("def "):
            source.fail(begin, f"{text[:40]!r} cannot be read; valid: a function without arguments")
        elif text == "end":
            if not function:
                source.fail(begin, "end without a function")
            function = ""
        else:
            found.append(_Line(begin, text, function))
        text = ""
    if text:
        source.fail(begin, "a bracket is not closed")
    if function:
        source.fail(found[-1].line if found else 1, f"the end of the function {function} is missing")
    return found


def _move(source: Source, line: int, name: str, inside: str, known: dict[str, Value]) -> _Move:
    given: dict[str, str] = {}
    for k, argument in enumerate(_arguments(inside)):
        key, equals, value = argument.partition("=")
        key = key.strip() if equals else (ARGUMENTS[name][k : k + 1] or ("",))[0]
        if key not in ARGUMENTS[name] or key in given:
            source.fail(
                line, f"{name} has an argument {argument[:40]!r}; valid: {', '.join(ARGUMENTS[name])}, once each"
            )
        given[key] = value.strip() if equals else argument
    target = given.get("q", "")
    q = _value(target, known)
    if not isinstance(q, list):
        source.fail(
            line, f"{name} to {target[:60] or 'nothing'} cannot be read; valid: a list of numbers, or its variable"
        )
    numbers = {}
    for key in ("t", "r"):
        value = _value(given.get(key, "0"), known)
        if not isinstance(value, float) or not 0 <= value < LARGEST:
            source.fail(line, f"{key}={given[key][:40]} cannot be read; a number is needed")
        numbers[key] = value
    servo = name == "servoj"
    time_s = numbers["t"] or (SERVO_S if servo and "t" not in given else None)
    return _Move(line, q, time_s, numbers["r"], servo)


def _word(text: str) -> str:
    return re.split(r"\W", text, maxsplit=1)[0]


def _arguments(text: str) -> list[str]:
    found, depth = [""], 0
    for letter in text:
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and not depth:
            found.append("")
        else:
            found[-1] += letter
    return [each.strip() for each in found]


def _value(text: str, known: dict[str, Value]) -> Value:
    """Return the value of an expression of numbers: a number, or a list of numbers; None for anything else."""
    try:
        return _computed(ast.parse(text.strip(), mode="eval").body, known)
    except (SyntaxError, ValueError, RecursionError, ArithmeticError):
        return None


def _computed(node: ast.expr, known: dict[str, Value]) -> Value:
    """Return the value of an expression; None if it is not one of numbers, or if its value is not certain."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id=name):
            return known.get(name)
        case ast.List(elts=elements):
            items = [_computed(each, known) for each in elements]
            return [each for each in items if isinstance(each, float)] if all(map(_is_number, items)) else None
        case ast.UnaryOp(op=ast.UAdd() | ast.USub() as sign, operand=inner) if _is_number(_computed(inner, known)):
            value = _computed(inner, known)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATIONS:
            both = _computed(left, known), _computed(right, known)
            if not all(map(_is_number, both)):
                return None
            if isinstance(op, ast.Div) and not (_has_point(left) or _has_point(right)):
                return None  # of integers
            return OPERATIONS[type(op)](*both)
        case ast.Call(func=ast.Name(id="d2r"), args=[inner], keywords=[]) if _is_number(_computed(inner, known)):
            return DEG * _computed(inner, known)
    return None


def _has_point(node: ast.expr) -> bool:
    """Return True if a number is certainly no integer for the controller."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, float)
        case ast.UnaryOp(operand=inner):
            return _has_point(inner)
        case ast.BinOp(left=left, right=right):
            return _has_point(left) or _has_point(right)
    return isinstance(node, ast.Call)


def _is_call(text: str) -> bool:
    """Return True if a text is one call of a function."""
    try:
        return isinstance(ast.parse(text, mode="eval").body, ast.Call)
    except (SyntaxError, ValueError, RecursionError):
        return False


def _is_number(value: Value) -> bool:
    return isinstance(value, float)
