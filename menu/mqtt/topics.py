"""Topics and contents of the messages, and the message by which Home Assistant discovers them."""

from __future__ import annotations

from typing import Any

import camctl
from camctl.menu.model import Model
from camctl.menu.ports import Screen

COMMANDS = ("shoot", "series", "cancel")
"""What is taken from the command topic."""

ONLINE, OFFLINE = "online", "offline"

DISCOVERY = "homeassistant"
"""Beginning of Home Assistant's topics, unless its configuration names another."""


def topic(name: str, part: str) -> str:
    """Return a topic of the camera that is called `name`.

    Args:
        name: of the camera
        part: "command" takes one of `COMMANDS`; others are retained: "availability" has `ONLINE`
            while the menu runs, else `OFFLINE`, "state" what `state_message` returns, as JSON,
            "picture" the last picture as a PNG file
    """
    return f"camctl/{name}/{part}"


def discovery_topic(name: str) -> str:
    """Return the topic of what `discovery_message` returns, as JSON; retained."""
    return f"{DISCOVERY}/device/camctl-{name}/config"


def state_message(model: Model, screen: Screen, refused: str) -> dict[str, Any]:
    """Return the state of the menu.

    Args:
        model: the state
        screen: what it shows
        refused: the command that could not be done in this state; "" where there was none
    """
    reading, summary, progress = model.reading, model.summary, model.progress
    is_error = screen.mood.name == "ERROR"
    return {
        "state": model.state.value,
        "title": screen.title.texts[0],
        "mood": screen.mood.name.lower(),
        "camera": None if model.camera is None else model.camera.name,
        "error": model.error if is_error else "",
        "refused": refused,
        "done": None if progress is None else progress.done,
        "total": None if progress is None else progress.total,
        "progress": None if screen.share is None else round(100 * screen.share),
        "battery": None if reading is None else reading.battery_percent,
        "free_images": None if reading is None else reading.free_images,
        "folder": None if summary is None else summary.folder,
        "levels": None if summary is None else round(summary.effective_levels, 1),
        "clipped": None if summary is None else round(100 * summary.saturated, 2),
        "trustworthy": None if summary is None else not summary.untrustworthy_because,
    }


_SENSORS: dict[str, dict[str, str]] = {
    "title": {"name": "State", "icon": "mdi:camera"},
    "progress": {"name": "Progress", "unit_of_measurement": "%", "icon": "mdi:progress-clock"},
    "battery": {"name": "Battery", "unit_of_measurement": "%", "device_class": "battery"},
    "free_images": {"name": "Free pictures on the card", "icon": "mdi:sd"},
    "levels": {"name": "Effective levels of the last picture", "icon": "mdi:image-check"},
    "error": {"name": "Error", "icon": "mdi:alert"},
}
"""Fields of the state that are sensors, and how Home Assistant shows them."""

_ICONS = {"shoot": "mdi:camera-iris", "series": "mdi:camera-timer", "cancel": "mdi:cancel"}


def discovery_message(name: str) -> dict[str, Any]:
    """Return the description of the device for Home Assistant (MQTT device discovery, 2024.11)."""
    unique = f"camctl-{name}"
    buttons = {
        command: {
            "platform": "button",
            "unique_id": f"{unique}-{command}",
            "name": command.capitalize(),
            "command_topic": topic(name, "command"),
            "payload_press": command,
            "icon": _ICONS[command],
        }
        for command in COMMANDS
    }
    sensors = {
        field: {
            "platform": "sensor",
            "unique_id": f"{unique}-{field}",
            "state_topic": topic(name, "state"),
            "value_template": f"{{{{ value_json.{field} }}}}",
            **shown,
        }
        for field, shown in _SENSORS.items()
    }
    picture = {
        "platform": "image",
        "unique_id": f"{unique}-picture",
        "name": "Last picture",
        "image_topic": topic(name, "picture"),
        "content_type": "image/png",
    }
    return {
        "device": {
            "identifiers": [unique],
            "name": f"camctl {name}",
            "manufacturer": "camctl",
            "sw_version": camctl.__version__,
        },
        "origin": {"name": "camctl", "sw_version": camctl.__version__},
        "availability_topic": topic(name, "availability"),
        "components": {**buttons, **sensors, "picture": picture},
    }
