"""Where a hand is wanted, and the steps in which it gets there.

A page tells of a drag twenty times a second at most. In steps between two of its messages
the plant follows as often as a screen shows pictures, one message behind.
"""

from dataclasses import dataclass, replace

from plantsim.arrays import Array

BETWEEN = 0.05  # [s] between two messages of a drag, at the least
FASTEST = 1 / 60  # [s] between two frames: what screens show
LATE, SLOWER = 0.07, 1 / 40  # [s] after which the page is behind, and frames then
LOST = 0.2  # [s] after which a message is the first of a motion


@dataclass(frozen=True, eq=False)
class Goal:
    """A shift (3,) [m] from rest and a held rotation vector (3,) [rad], in equal steps.

    `pace` [s]: from one step to the next.
    """

    shift: Array
    turn: Array | None = None
    steps: int = 1
    pace: float = FASTEST

    def first(self, before: "Goal") -> "Goal":
        """Return where the next step leads to from another goal that was met."""
        shift = before.shift + (self.shift - before.shift) / self.steps
        turn = self.turn
        if turn is not None and before.turn is not None:
            turn = before.turn + (turn - before.turn) / self.steps
        return Goal(shift, turn, pace=self.pace)

    def rest(self) -> "Goal | None":
        """Return the same goal in the steps that are left after the first, if any."""
        return replace(self, steps=self.steps - 1) if self.steps > 1 else None


def steps(seconds: float, frame: float) -> tuple[int, float]:
    """Return into how many frames to divide the way of a message, and the time [s] of each.

    It came `seconds` after the one before; a frame takes `frame` [s] or more. A page that
    draws a picture in 45 ms tells of every second one: its pictures between are worth a
    frame too.
    """
    pace = max(FASTEST if seconds < LATE else SLOWER, frame)
    whole = BETWEEN if seconds < LATE else seconds
    return (max(1, round(whole / pace)) if seconds < LOST else 1), pace
