"""Drive a robot through the commands of a scenario file.

Each command is sent again every COMMAND_PERIOD_S with a new sequence number, which keeps it alive;
one that is not answered is simply followed by the next. The robot is stopped and its power stage
switched off at the end, whatever ends the drive.
"""

import math
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from omnislip.errors import InputError, RobotError
from omnislip.link import protocol
from omnislip.link.session import Refused, Session
from omnislip.scenario import Scenario

COMMAND_PERIOD_S = 0.05
LOST_AFTER_S = 1.0
NOW_S = 5e-4  # what comes sooner is now: half a tick

_Q13_PER_UNIT = 1000 * 2**13  # of mm from m, of mrad from rad


@dataclass(frozen=True)
class Driven:
    """How a drive went: commands sent, answered, and how often the robot saw none for too long."""

    commands: int
    answered: int
    timeouts: int


def to_request(command: dict[str, Any]) -> tuple[str, dict[str, int]]:
    """Return name and raw fields of the request for a scenario's command. InputError: too large."""
    kind, value = command["kind"], command["value"]
    if kind == "stop":
        return "stop", {}
    if kind == "velocity":
        raw = [round(1000 * v) for v in value]
    elif kind == "duty":
        raw = [min(round(2**15 * d), 32767) for d in value]
    else:
        turn = math.remainder(value[2], 2 * math.pi)
        raw = [round(_Q13_PER_UNIT * v) for v in (value[0], value[1], turn)]
        raw += [round(2**13 * value[3]), round(2**13 * value[4]), round(2**11 * value[5])]
    fields = dict(zip(protocol.REQUESTS[kind].fields.names, raw, strict=True))
    try:
        protocol.encode_request(kind, 0, fields)
    except struct.error as error:
        raise InputError(f"command at {command['t_s']:g} s: {kind} {value}: {error}") from None
    return kind, fields


def drive(
    session: Session, scenario: Scenario, tell: Callable[[str], None] = lambda text: None
) -> Driven:
    """Drive the programme. RobotError when the robot refuses, fails or is heard no more.

    `session.status` must be watched.
    """
    programme = [(command["t_s"], *to_request(command)) for command in scenario.commands]
    status = session.fresh_status()
    if status.state == "FAULT":
        raise RobotError(f"the robot is in state {status}; 'clear-fault' ends that")
    believed = session.request("parameter_get", id=_slip_compensation().id)["value"]
    _set_slip_compensation(session, int(scenario.slip_compensation))
    try:
        session.request("arm")
        driven = _run(session, programme, scenario.duration_s, tell)
    except BaseException:
        _end(session, believed, (RobotError,))
        raise
    _end(session, believed, ())
    return driven


def _end(session: Session, believed: int, ignored: tuple[type[RobotError], ...]) -> None:
    """Stop, power stage off, `slip_compensation` as before."""
    with suppress(*ignored):
        session.request("stop")
    with suppress(*ignored):
        session.request("disarm")
    with suppress(*ignored):
        _set_slip_compensation(session, believed)


def _slip_compensation() -> protocol.Parameter:
    return protocol.PARAMETERS["slip_compensation"]


def _set_slip_compensation(session: Session, on: int) -> None:
    session.request("parameter_set", id=_slip_compensation().id, value=on)


def _run(
    session: Session,
    programme: list[tuple[float, str, dict[str, int]]],
    duration_s: float,
    tell: Callable[[str], None],
) -> Driven:
    clock = session.line.time_s
    begin_s = heard_s = clock()
    commands = answered = timeouts = 0
    session.events.clear()
    while (now_s := clock() - begin_s) < duration_s - NOW_S:
        due = [entry for entry in programme if entry[0] <= now_s + NOW_S]
        later = [entry[0] for entry in programme[len(due) :]]
        next_s = min([now_s + COMMAND_PERIOD_S, duration_s, *later[:1]])
        if due:
            _, name, fields = due[-1]
            commands += 1
            if _offer(session, name, next_s - now_s, fields):
                answered += 1
                heard_s = clock()
        session.listen(begin_s + next_s - clock())
        timeouts += _watch(session)
        if due and clock() - heard_s > LOST_AFTER_S:
            raise RobotError(f"the robot has not answered for {LOST_AFTER_S:g} s")
        tell(f"{now_s:.1f} of {duration_s:g} s")
    return Driven(commands, answered, timeouts)


def _offer(session: Session, name: str, timeout_s: float, fields: dict[str, int]) -> bool:
    """Send a command once; return whether it was answered. A fault that refuses it is named."""
    try:
        return session.offer(name, timeout_s, **fields)
    except Refused as refused:
        if refused.result == "STATE":
            session.fresh_status()
            _watch(session)
        raise


def _watch(session: Session) -> int:
    """Return how many command timeouts the robot has told of. RobotError: any other fault."""
    timeouts = sum(
        event.name == "state"
        and protocol.name_of("fault", event.values["fault"]) == "COMMAND_TIMEOUT"
        for event in session.events
    )
    session.events.clear()
    status = session.status
    if status is not None and status.state == "FAULT":
        reason = protocol.FAULTS[status.fault]
        raise RobotError(f"the robot has ended the drive: {reason} ({status})")
    return timeouts
