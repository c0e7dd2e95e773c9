"""The entries of the menu's lists, and the values that they stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace

from camctl.menu.data import Choice, Cost, SeriesChoice, Settings
from camctl.menu.model import Action, Goal, Model, State
from camctl.menu.tables import STATES
from camctl.menu.text import format_levels, format_short_time
from camctl.system.number_text import range_text

TOGETHER = " + "
"""Between the ids of cameras that take each picture together."""
#: Share of a point's time that its plan may take: the light is metered again, with noise.
_AGAIN = 1.02


@dataclass(frozen=True)
class Entry:
    """One line of a list.

    Attributes:
        labels: what a panel calls it, the longest first; the last has at most 14 characters
        value: what it stands for
        action: what the enter key does with it; None: the next state
    """

    labels: tuple[str, ...]
    value: object = None
    action: Action | None = None


def _entries(*entries: tuple[object, *tuple[str, ...]]) -> tuple[Entry, ...]:
    return tuple(Entry(tuple(labels), value) for value, *labels in entries)


RESPONSES = _entries(
    ("log", "Constant contrast", "Const.contrast"),
    ("linear", "Linear"),
    ("gamma", "Gamma 1/2"),
    ("auto", "Auto, from the light", "Auto"),
)
RANGES = (
    Entry(("Low 1:256",), 256.0),
    Entry(("Medium 1:1,000", "Medium 1:1000"), 1000.0),
    Entry(("High 1:16,000", "High 1:16000"), 16000.0),
    Entry(("Auto, from the light", "Auto"), None),
    Entry(("Custom ...",), action=Action.CUSTOM),
)
CUSTOM = len(RANGES) - 1
STOPS = tuple(
    Entry((f"{stops} stops {range_text(2**stops)}", f"{stops} stops"), float(2**stops))
    for stops in range(4, 21)
)
COUNTS = (
    Entry(("Recommended",)),
    Entry(("Time / accuracy ...", "Time/accuracy"), action=Action.FRONT),
    *(Entry((f"{n} exposure{'s' * (n > 1)}", f"{n} exp."), n) for n in range(1, 7)),
    Entry(("Time budget ...", "Time limit ..."), action=Action.BUDGET),
)
BUDGETS = tuple(
    Entry((f"{value:g} s at most", f"{value:g} s"), value)
    for value in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
)
TIMERS = _entries(*((s, f"Self-timer {s} s", f"Timer {s} s") for s in (2, 10, 30, 60)))
SAVERS = _entries(
    (0, "Screen saver off", "Saver off"),
    *((60 * m, f"Screen saver {m} min", f"Saver {m} min") for m in (5, 15, 60)),
)
MAINS = _entries(
    (None, "Daylight"),
    (50.0, "Lamps 50 Hz mains", "Lamps 50 Hz"),
    (60.0, "Lamps 60 Hz mains", "Lamps 60 Hz"),
)
METERINGS = _entries(
    (False, "No shots for metering", "No meter shots"),
    (True, "Shots for metering", "Meter shots"),
)
INTERVALS = (
    Entry(("At once",), None),
    *(
        Entry((f"Every {text}",), seconds)
        for text, seconds in (
            *(("5 s", 5.0), ("10 s", 10.0), ("30 s", 30.0), ("1 min", 60.0), ("2 min", 120.0)),
            *(("5 min", 300.0), ("10 min", 600.0), ("30 min", 1800.0), ("1 h", 3600.0)),
        )
    ),
)
REPEATS = tuple(
    Entry((f"{n} pictures",), n) for n in (2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
)
CALIBRATIONS = _entries(
    ("still", "Still scene: response and noise", "Still scene"),
    ("covered", "Lens covered: dark signal", "Lens covered"),
)
MAIN_MENU = tuple(
    Entry((label,), action=action)
    for label, action in (
        ("Take a picture", Action.SET),
        ("Series", Action.SERIES),
        ("Captures", Action.CAPTURES),
        ("Camera", Action.OTHER),
        ("Settings", Action.SETTINGS),
        ("Calibration", Action.CALIBRATE),
        ("About", Action.ABOUT),
        ("Quit", Action.QUIT),
    )
)
KEPT: dict[str, tuple[Entry, ...]] = {
    "response": RESPONSES,
    "range": RANGES,
    "stops": STOPS,
    "count": COUNTS,
    "budget": BUDGETS,
    "timer": TIMERS,
    "saver": SAVERS,
    "mains": MAINS,
    "metering": METERINGS,
    "interval": INTERVALS,
    "repeat": REPEATS,
}
"""The fields of `Settings` that hold an index, with their entries."""
CHANGEABLE = ("timer", "saver", "mains", "metering")
"""Those that the settings screen changes."""
_OF_SERIES = ("repeat", "interval")
"""Those that the screen of a series changes."""


def rows(model: Model) -> tuple[Entry, ...]:
    """Return the entries of the list that is shown; () on other screens."""
    match model.state:
        case State.CAMERAS:
            found = tuple(Entry((each.name, each.id), each.id) for each in model.cameras)
            several = Entry(("Several at once ...", "Several ..."), action=Action.SEVERAL)
            return (*found, several) if len(found) > 1 else found
        case State.SEVERAL:
            return _markable(model)
        case State.CALIBRATION:
            return CALIBRATIONS
        case State.CAPTURES:
            return tuple(
                Entry(
                    _capture_names(each.name),
                    each,
                    None if each.is_complete else Action.RESUME,
                )
                for each in model.captures
            )
        case State.FRONT:
            return tuple(map(_point_entry, model.front))
        case State.SETTINGS:
            return _changeable(model.settings, CHANGEABLE)
        case State.SERIES:
            start = Entry((f"Start, {_duration(series(model))}", "Start"), action=Action.START)
            return (*_changeable(model.settings, _OF_SERIES), start)
        case State.MENU:
            return MAIN_MENU
    return KEPT.get(STATES[model.state].cursor, ())


def _changeable(settings: Settings, names: tuple[str, ...]) -> tuple[Entry, ...]:
    """Return an entry for each of these settings, which the enter key changes."""
    return tuple(
        Entry(KEPT[name][getattr(settings, name)].labels, name, Action.CHANGE) for name in names
    )


def chosen_cameras(model: Model) -> tuple[str, ...]:
    """Return the ids of the cameras that are to take pictures together: all if none is marked."""
    ids = tuple(each.id for each in model.cameras if TOGETHER not in each.id)
    return tuple(each for each in ids if each in model.marked) or ids


def _markable(model: Model) -> tuple[Entry, ...]:
    cameras = [each for each in model.cameras if TOGETHER not in each.id]
    marks = ["[x] " if each.id in model.marked else "[ ] " for each in cameras]
    count = len(chosen_cameras(model))
    which = f"{'these' if model.marked else 'all'} {count}" if count > 1 else "this one"
    return (
        *(
            Entry((mark + each.name, mark + each.id[-10:]), each.id, Action.CHANGE)
            for mark, each in zip(marks, cameras, strict=True)
        ),
        Entry((f"Use {which}",), action=Action.START),
    )


_UNITS = ((86400, "days"), (3600, "h"), (60, "min"), (1, "s"))


def _duration(asked: SeriesChoice) -> str:
    """Return how long a series takes from its first start to its last.

    >>> _duration(SeriesChoice(Choice("log", 1000.0), 20, 120.0))
    '38 min in all'
    """
    if asked.interval_s is None:
        return "one after the other"
    total_s = (asked.count - 1) * asked.interval_s
    unit_s, unit = next(each for each in _UNITS if total_s >= 2 * each[0] or each[0] == 1)
    return f"{total_s / unit_s:.3g} {unit} in all"


def series(model: Model) -> SeriesChoice:
    """Return the series that was selected, each picture as the next capture would be."""
    settings = model.settings
    interval = INTERVALS[settings.interval].value
    count = int(_number(REPEATS[settings.repeat].value))
    return SeriesChoice(requested(model), count, None if interval is None else _number(interval))


def _point_entry(point: Cost) -> Entry:
    """Return the entry of a point of the front, in two digits of its time.

    >>> _point_entry(Cost(6, wall_s=1.83, effective_levels=126.6)).labels
    ('1.8 s, 127 levels', '1.8 s')
    """
    assert point.wall_s is not None
    time = format_short_time(float(f"{point.wall_s:.2g}"))
    return Entry((f"{time}, {format_levels(point.effective_levels)} levels", time), point)


def _capture_names(name: str) -> tuple[str, ...]:
    """Return the name of a capture's folder in several lengths.

    >>> _capture_names("capture-0012-20261122-083059")
    ('capture-0012-20261122-083059', '0012-20261122-083059', '0012-1122-0830')
    """
    short = name.removeprefix("capture-")
    number, *date = short.split("-")
    shortest = f"{number}-{date[0][4:]}-{date[1][:4]}" if len(date) == 2 else short
    return (name, short, shortest[-14:])


def choice(settings: Settings, goal: Goal) -> Choice:
    """Return what the settings ask for, when the exposures are chosen by `goal`."""
    chosen = RANGES[settings.range]
    value = STOPS[settings.stops].value if chosen.action is Action.CUSTOM else chosen.value
    by_count = goal is Goal.COUNT and COUNTS[settings.count].value is not None
    return Choice(
        str(RESPONSES[settings.response].value),
        None if value is None else _number(value),
        count=int(_number(COUNTS[settings.count].value)) if by_count else None,
        time_budget_s=_number(BUDGETS[settings.budget].value) if goal is Goal.BUDGET else None,
        mains_hz=mains_hz(settings),
        spend_shutter=bool(METERINGS[settings.metering].value),
    )


def requested(model: Model) -> Choice:
    """Return what was chosen: a point of the front as long as its response and range are."""
    asked = choice(model.settings, model.goal)
    if model.goal is Goal.FRONT and model.point is not None:
        point, traced = model.point
        if traced == asked and point.wall_s is not None:
            budget_s = point.wall_s * _AGAIN
            return replace(asked, time_budget_s=budget_s, dynamic_range=point.dynamic_range)
    return asked


def mains_hz(settings: Settings) -> float | None:
    """Return the frequency of the mains, Hz; None: daylight."""
    value = MAINS[settings.mains].value
    return None if value is None else _number(value)


def seconds(entry: Entry) -> int:
    """Return the value of an entry of `TIMERS` or `SAVERS`, s."""
    return int(_number(entry.value))


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)
