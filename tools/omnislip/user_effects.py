"""Effects that a user defines: a table of the model file, or of a file for `gap find --effects`.

    [define.cubic_drag]
    summary = "Drag on the shaft that grows with the cube of the speed."      # optional
    adds_to = "shaft_torque_nm"
    expression = "-c_nm_s3 * W**3"
    wheels = "all"                              # "all" (default), "one", or "all or one"
    parameters.c_nm_s3 = { unit = "N m s^3", typical = 2e-10, low = 0.0 }

The term is added where `adds_to` says, beside the catalogue's own effects, and is screened, fitted,
ranked and reported like them. What `expression` may name depends on where it acts (`TARGETS`):

    d duty, W shaft speed and th_m shaft angle (rad), tau motor torque, s slip, VT and VF hub speed
    along and across the wheel (m/s), t time (s), vx vy w body velocity in the body frame, x y theta
    place in the world; its own parameters; pi; + - * / **, < > <= >=, "a if condition else b" and
    abs sign sqrt exp log sin cos tan atan tanh min max.

A parameter is a size, with `typical` (offset from `neutral`, default 0, that is worth looking for)
and optional bounds `low`, `high`; or it shapes the effect, with `start`, a list of values to begin
fits from. With all sizes neutral the expression must be 0, and with typical ones it must be a
number at standstill, where logs begin. On an axis, shafts are the axis: W its
speed, th_m its position, d the command.
"""

import ast
import keyword
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omnislip import _core
from omnislip.errors import InputError
from omnislip.files import check_known, check_number, check_table, load_toml, nearest

MOTION = ("t", "vx", "vy", "w", "x", "y", "theta")
GOES_WITH = {"angle": {"th_m"}, "place": {"x", "y", "theta"}}
"""What an effect may go with, as the catalogue says, by what it names."""


@dataclass(frozen=True)
class Target:
    """A place of the model to add to: what may be named there, and which part of the machine."""

    inputs: tuple[str, ...]
    where: str
    per_motor: bool = False
    kinds: tuple[str, ...] = ("robot",)


TARGETS = {
    "duty": Target(("d",), "driver", True, ("robot", "axis")),
    "supply_v": Target(("t",), "supply"),
    "shaft_torque_nm": Target(("t", "W", "th_m", "tau"), "shaft", True, ("robot", "axis")),
    "mu_drive": Target((*MOTION, "W", "th_m", "s", "VT", "VF"), "wheel", True),
    "body_force_x_n": Target(MOTION, "body"),
    "body_force_y_n": Target(MOTION, "body"),
    "body_torque_nm": Target(MOTION, "body"),
    "gyro_rad_s": Target(MOTION, "sensor"),
    "pose_x_m": Target(MOTION, "sensor"),
    "pose_y_m": Target(MOTION, "sensor"),
    "pose_theta_rad": Target(MOTION, "sensor"),
}
SCOPES = {"all": "common", "one": "single", "all or one": "common or single"}
KEYS = ("summary", "adds_to", "expression", "wheels", "parameters")
PARAMETER_KEYS = ("unit", "typical", "neutral", "low", "high", "start")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")  # a key of TOML without quotes, a name of Python
MOST_EFFECTS = 16
DEEPEST = 16

OPERATORS = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.Pow: "power",
}
FUNCTIONS = {
    "abs": np.abs,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan": np.arctan,
    "tanh": np.tanh,
    "min": min,
    "max": max,
}
OF_TWO = ("min", "max")

Program = list[tuple[str, Any]]


def read_definitions(path: Path | str) -> dict[str, dict[str, Any]]:
    """Return the [define.NAME] tables of a file of effects, unchecked: read_entries checks them."""
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(f"{path}: effects are defined in TOML only, in a file that ends in .toml")
    data = load_toml(path)
    check_known(data, ["define"], "table", path)
    if not data:
        raise InputError(f"{path}: defines no effect; it needs a table [define.NAME]")
    return check_table(data["define"], "define", path)


def read_entries(tables: Mapping[str, Any], kind: str, path: Path) -> list[dict[str, Any]]:
    """Return the definitions as entries like those of `_core.effects()`.

    Each has besides: `adds_to`, `program` for `_core`, and `starts` of the shaping parameters.
    InputError names the effect and the key.
    """
    if len(tables) > MOST_EFFECTS:
        raise InputError(
            f"{path}: {len(tables)} effects are defined, at most {MOST_EFFECTS} can be"
        )
    return [_read_entry(name, table, kind, path) for name, table in tables.items()]


def _read_entry(name: str, table: object, kind: str, path: Path) -> dict[str, Any]:
    where = f"define.{name}"
    table = check_table(table, where, path)
    _check_name(name, where, path)
    if name in {entry["name"] for entry in _core.effects()}:
        raise InputError(f"{path}: '{where}': the catalogue has an effect of that name already")
    check_known(table, KEYS, f"key in [{where}]", path)
    missing = [key for key in ("adds_to", "expression", "parameters") if key not in table]
    if missing:
        raise InputError(f"{path}: [{where}] misses {', '.join(missing)}")
    target = _read_target(table["adds_to"], where, kind, path)
    parameters = [
        _read_parameter(key, item, target, f"{where}.parameters.{key}", path)
        for key, item in check_table(table["parameters"], f"{where}.parameters", path).items()
    ]
    if not any(p["typical"] for p in parameters):
        raise InputError(f"{path}: [{where}] needs a parameter with 'typical', the effect's size")
    expression = _text(table["expression"], f"{where}.expression", path)
    tree = _parse(expression, where, path)
    program = _Compiler(table["adds_to"], parameters, where, path).compile(tree)
    _check_sizes(tree, target, parameters, where, path)
    equation = f"{table['adds_to']} += {expression}"
    named = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return {
        "name": name,
        "summary": _text(table.get("summary", equation), f"{where}.summary", path),
        "equation": equation,
        "where": target.where,
        "source": f"defined in {path.name}",
        "scope": _read_scope(table.get("wheels"), target, where, path),
        "per_wheel": target.per_motor,
        "kinds": list(target.kinds),
        "goes_with": [what for what, names in GOES_WITH.items() if named & names],
        "parameters": parameters,
        "adds_to": table["adds_to"],
        "program": program,
    }


def _check_name(name: str, where: str, path: Path) -> None:
    if not NAME.fullmatch(name):
        raise InputError(
            f"{path}: '{where}': a name has ASCII letters, digits and _ only, and no digit first"
        )


def _text(value: object, where: str, path: Path) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{path}: '{where}' must be a text, not {value!r}")
    return value


def _read_target(value: object, where: str, kind: str, path: Path) -> Target:
    known = [name for name, target in TARGETS.items() if kind in target.kinds]
    if not known:
        raise InputError(f"{path}: '{where}': a model of kind '{kind}' takes no own effects")
    if value not in known:
        raise InputError(
            f"{path}: '{where}.adds_to' must be one of {', '.join(known)}, not {value!r}"
        )
    return TARGETS[str(value)]


def _read_scope(value: object, target: Target, where: str, path: Path) -> str:
    if not target.per_motor:
        if value is not None:
            raise InputError(f"{path}: [{where}] acts on the whole machine; remove 'wheels'")
        return "whole"
    if value is not None and value not in list(SCOPES):
        raise InputError(
            f"{path}: '{where}.wheels' must be one of {', '.join(SCOPES)}, not {value!r}"
        )
    return SCOPES[str(value or "all")]


def _read_parameter(
    name: str, table: object, target: Target, where: str, path: Path
) -> dict[str, Any]:
    table = check_table(table, where, path)
    _check_name(name, where, path)
    if keyword.iskeyword(name) or name in (*target.inputs, *FUNCTIONS, "pi", "wheel", "run"):
        raise InputError(f"{path}: '{where}': '{name}' cannot be the name of a parameter here")
    check_known(table, PARAMETER_KEYS, f"key in '{where}'", path)
    if ("typical" in table) == ("start" in table):
        raise InputError(
            f"{path}: '{where}' needs either 'typical' (a size worth looking for) or 'start' "
            f"(values to begin fits from)"
        )
    starts = _read_starts(table.get("start"), f"{where}.start", path)
    low, high = (
        float(table[key])
        if table.get(key) in (-math.inf, math.inf)
        else check_number(table.get(key, 0.0), f"{where}.{key}", path)
        if key in table
        else limit
        for key, limit in (("low", -math.inf), ("high", math.inf))
    )
    neutral = check_number(table.get("neutral", starts[0]), f"{where}.neutral", path)
    typical = check_number(table.get("typical", 0.0), f"{where}.typical", path)
    if "typical" in table and typical == 0:
        raise InputError(f"{path}: '{where}.typical' must not be 0")
    for value in (neutral, neutral + typical, *(starts if "start" in table else ())):
        if not low <= value <= high:
            raise InputError(f"{path}: '{where}': {value:g} is not within low and high")
    return {
        "name": name,
        "unit": _text(table.get("unit"), f"{where}.unit", path),
        "neutral": neutral,
        "low": low,
        "high": high,
        "typical": typical,
        "starts": tuple(starts),
    }


def _read_starts(value: object, where: str, path: Path) -> list[float]:
    if value is None:
        return [0.0]
    if not isinstance(value, list) or not value:
        raise InputError(f"{path}: '{where}' must be a list of numbers, not {value!r}")
    return [check_number(item, where, path) for item in value]


def _parse(expression: str, where: str, path: Path) -> ast.expr:
    try:
        return ast.parse(expression.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = getattr(error, "msg", error)  # without Python's word for place and line
        raise InputError(f"{path}: '{where}.expression' is no expression: {reason}") from None


class _Compiler:
    """Turns an expression into the program of a stack machine (sim/user_terms.h)."""

    def __init__(
        self, adds_to: str, parameters: list[dict[str, Any]], where: str, path: Path
    ) -> None:
        self._adds_to, self._inputs = adds_to, TARGETS[adds_to].inputs
        self._parameters = [p["name"] for p in parameters]
        self._where, self._path = where, path

    def compile(self, tree: ast.expr) -> Program:
        program = self._of(tree)
        used = {argument for operation, argument in program if operation == "parameter"}
        for number, name in enumerate(self._parameters):
            if number not in used:
                raise self._error(f"does not use the parameter '{name}'")
        depth = deepest = 0
        for operation, _ in program:
            depth += {"constant": 1, "parameter": 1, "input": 1, "where": -2}.get(operation, 0)
            depth -= operation in (*OPERATORS.values(), *OF_TWO, "less")
            deepest = max(deepest, depth)
        if deepest > DEEPEST:
            raise self._error("is nested too deeply; simplify it")
        return program

    def _of(self, node: ast.expr) -> Program:
        match node:
            case ast.Constant(value=bool()):
                pass
            case ast.Constant(value=int() | float() as value) if value <= sys.float_info.max:
                return [("constant", float(value))]
            case ast.Constant(value=int() | float()):
                raise self._error("contains a number that is too large")
            case ast.Name(id=name):
                return self._name(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return [*self._of(operand), ("negate", 0)]
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._of(operand)
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)) if (
                0 <= power <= 16
            ):
                return [*self._of(left), ("integer_power", power)]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
                return [*self._of(left), *self._of(right), (OPERATORS[type(op)], 0)]
            case ast.Compare(left=a, ops=[ast.Lt() | ast.LtE()], comparators=[b]):
                return [*self._of(a), *self._of(b), ("less", 0)]
            case ast.Compare(left=a, ops=[ast.Gt() | ast.GtE()], comparators=[b]):
                return [*self._of(b), *self._of(a), ("less", 0)]
            case ast.Compare(ops=[_, _, *_]) | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                raise self._error(
                    f"cannot contain '{ast.unparse(node)}': a condition compares two values; for "
                    f"more put one 'a if condition else b' into another"
                )
            case ast.IfExp(
                test=(ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not())) as test,
                body=body,
                orelse=orelse,
            ):
                return [*self._of(test), *self._of(body), *self._of(orelse), ("where", 0)]
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                wanted = 2 if name in OF_TWO else 1
                if len(args) != wanted:
                    raise self._error(f"gives {name} {len(args)} values, it takes {wanted}")
                return [*(step for argument in args for step in self._of(argument)), (name, 0)]
            case ast.Call(func=ast.Name(id=name)) if name in FUNCTIONS:
                raise self._error(f"names the values of {name}; give them without names")
            case ast.Call(func=ast.Name(id=name)):
                raise self._error(f"calls '{name}'{nearest(name, FUNCTIONS)}")
        raise self._error(f"cannot contain '{ast.unparse(node):.80}'")

    def _name(self, name: str) -> Program:
        if name in self._parameters:
            return [("parameter", self._parameters.index(name))]
        if name in self._inputs:
            return [("input", name)]
        if name == "pi":
            return [("constant", math.pi)]
        raise self._error(
            f"names '{name}'; known where it adds to {self._adds_to}: "
            f"{', '.join([*self._inputs, *self._parameters])}"
        )

    def _error(self, what: str) -> InputError:
        return InputError(f"{self._path}: '{self._where}.expression' {what}")


def _check_sizes(
    tree: ast.expr, target: Target, parameters: list[dict[str, Any]], where: str, path: Path
) -> None:
    """The term must vanish with its sizes and must not without, whatever the motion."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant):
            node.value = float(node.value)  # of whole numbers Python would write out 9**9**9
    absent = {p["name"]: p["neutral"] for p in parameters}
    there = {p["name"]: p["neutral"] + p["typical"] for p in parameters}
    generator = np.random.default_rng(0)
    still = dict.fromkeys(target.inputs, 0.0)
    samples = [
        dict(zip(target.inputs, row, strict=False)) for row in generator.normal(0.5, 1.0, (50, 12))
    ]
    neutral = [_evaluate(tree, sample | absent) for sample in (still, *samples)]
    if not np.isfinite([*neutral, _evaluate(tree, still | there)]).all():
        raise InputError(
            f"{path}: '{where}.expression' is no number at standstill or for some motions (root or "
            f"logarithm of a negative, division by 0, a number too large?)"
        )
    if np.any(neutral):
        raise InputError(
            f"{path}: '{where}.expression' must be 0 when every size has its neutral value"
        )
    if not any(_evaluate(tree, sample | there) != 0 for sample in samples):
        raise InputError(f"{path}: '{where}.expression' stays 0 at the typical sizes")


def _evaluate(tree: ast.expr, names: Mapping[str, float]) -> float:
    """Value of a compiled expression in Python: its nodes and names have been checked."""
    code = compile(ast.Expression(tree), "expression", "eval")
    numbers = {name: np.float64(value) for name, value in names.items()}
    with np.errstate(all="ignore"):
        try:
            return float(eval(code, {"__builtins__": {}, "pi": math.pi, **FUNCTIONS}, numbers))
        except (ArithmeticError, TypeError):
            return math.nan
