"""What the line carries when telemetry fills it, and how long a request takes meanwhile.

    .venv/bin/python tests/link/throughput.py       ten seconds of each robot, in its own time

Both streams of the user ask for far more than the line carries, so the robot skips samples and the
line is never idle; a request every 50 ms has to find its way in between.
"""

from link_bench import robot
from omnislip.link import protocol
from omnislip.link.session import Session
from omnislip.virtual_robot import VirtualLine

LARGE = [name for name, signal in protocol.SIGNALS.items() if signal.size == 4][:15]
REQUEST_PERIOD_S = 0.05
FILL_S = 0.2


class CountingLine(VirtualLine):
    """A line that counts the bytes of the robot."""

    came = 0

    def read(self, timeout_s):
        data = super().read(timeout_s)
        self.came += len(data)
        return data


def measure(on_board, duration_s):
    """Return bytes per second from the robot and the longest time from request to answer in s."""
    line = CountingLine(robot(on_board=on_board))
    session = Session(line)
    session.connect()
    for stream in (0, 1):
        session.open_stream(stream, 1, LARGE, lambda sequence, raw: None)
    session.listen(FILL_S)
    begin_s, begin_bytes, longest_s = line.time_s(), line.came, 0.0
    while line.time_s() < begin_s + duration_s:
        asked_s = line.time_s()
        session.request("parameter_get", id=0)
        longest_s = max(longest_s, line.time_s() - asked_s)
        session.listen(asked_s + REQUEST_PERIOD_S - line.time_s())
    return (line.came - begin_bytes) / (line.time_s() - begin_s), longest_s


def main():
    for name, on_board in (("stub HAL", False), ("virtual LF2407A", True)):
        bytes_per_s, longest_s = measure(on_board, 10.0)
        print(f"{name}: {bytes_per_s:.0f} bytes/s, answers within {1e3 * longest_s:.0f} ms")


if __name__ == "__main__":
    main()
