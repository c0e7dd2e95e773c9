"""What can be wrong with a PTP camera's cable and firmware."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class WireFaults:
    """What is wrong with the cable and the firmware at the moment.

    Attributes:
        busy: operations that are answered Device_Busy; -1: all of them
        is_hanging: operations are not answered
        stalls: operations that stall the bulk endpoints
        truncations: objects of which half is sent ..
        answers_truncated: .. and a response after it, as if nothing had happened
        garbage: replies that are rubbish
        unplug_after: bytes of the next object after which the plug is pulled; -1: none
    """

    busy: int = 0
    is_hanging: bool = False
    stalls: int = 0
    truncations: int = 0
    answers_truncated: bool = False
    garbage: int = 0
    unplug_after: int = -1


class WireVerbs:
    """Verbs that set `faults`."""

    faults: WireFaults

    def do_busy(self, count: int = 5) -> None:
        """Answer the next operations, or all (-1), Device_Busy."""
        self.faults.busy = count

    def do_hang(self) -> None:
        """Answer no operation."""
        self.faults.is_hanging = True

    def do_stall(self, count: int = 1) -> None:
        """Stall instead of doing the next operations."""
        self.faults.stalls = count

    def do_truncate(self, count: int = 1, answers: bool = False) -> None:
        """Send half of the next objects, and after that nothing, or a response."""
        self.faults.truncations, self.faults.answers_truncated = count, answers

    def do_garbage(self, count: int = 1) -> None:
        """Reply rubbish."""
        self.faults.garbage = count
