"""The menu as a panel that a broker of MQTT connects with Home Assistant or other programs."""

from __future__ import annotations

import json
import os
import queue
import re
import socket
import ssl
import threading
from collections import deque
from pathlib import Path
from typing import Any, Self

from camctl.errors import UsageError
from camctl.menu.model import Action, Model, State
from camctl.menu.mqtt.topics import (
    COMMANDS,
    OFFLINE,
    ONLINE,
    discovery_message,
    discovery_topic,
    state_message,
    topic,
)
from camctl.menu.panels.address import parse_address
from camctl.menu.ports import Key, PanelDisconnectedError, Screen
from camctl.menu.studio.commands import Command, keys_for
from camctl.system.interrupts import uninterrupted

USER_VARIABLE, PASSWORD_VARIABLE = "CAMCTL_MQTT_USER", "CAMCTL_MQTT_PASSWORD"
"""Environment variables: a command line shows what stands in it to all users."""

_PORT, _TLS_PORT = 1883, 8883
"""Registered with IANA."""

_CONNECT_S = 10.0
"""A broker that does not answer within this time is not there, s: twice a slow network's time-out
of a lost packet and two repetitions (RFC 6298: 1, 2 s)."""

_KEEP_ALIVE_S = 30
"""The broker says that the menu is gone after one and a half of this time of silence, s."""

_MOST_PICTURE_BYTES = 16 << 20
"""A larger picture is not sent: Home Assistant keeps it in memory."""

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)
"""Names that Home Assistant takes in a topic of discovery."""

_COMMANDS: dict[str, tuple[Command, ...]] = {
    "shoot": (
        Command(seen=State.REVIEW, action=Action.SHOOT),
        Command(state=State.IDLE, action=Action.SHOOT),
    ),
    "series": (Command(state=State.SERIES, action=Action.START),),
    "cancel": tuple(
        Command(seen=state, key=Key.EXIT)
        for state in (
            *(State.PLANNING, State.TIMER, State.SHOOTING, State.RESUMING),
            *(State.SERIES_SHOOTING, State.CALIBRATING),
        )
    ),
}
"""What a command is in the page of the studio: the first one that is possible is done."""


class MqttPanel:
    """A client of a broker; a context manager.

    The broker may go and come back: the client connects again, and the menu goes on meanwhile.

    Args:
        address: the broker and options: ``HOST``, ``HOST:PORT``, ``HOST,name=hall,tls=1``
    """

    def __init__(self, address: str) -> None:
        parsed = parse_address(address, ("name", "tls"))
        self._has_tls = bool(parsed.number("tls", 0))
        host, _, port = parsed.words[0].rpartition(":")
        if not port.isdigit():
            host, port = parsed.words[0], str(_TLS_PORT if self._has_tls else _PORT)
        name = parsed.options.get("name", socket.gethostname().split(".")[0])
        if not host or not 0 < int(port) < 65536 or not _NAME.fullmatch(name):
            raise UsageError(
                f"invalid address {address!r} of the panel mqtt",
                hint="use HOST, HOST:PORT or HOST,name=NAME, with letters, digits, - and _",
            )
        self._broker = (host, int(port))
        self._name = name
        self._client: Any = None
        self._connected = threading.Event()
        self._refused_by_broker = ""
        self._commands: queue.Queue[str] = queue.Queue(64)
        self._keys: deque[Key] = deque()
        self._model = Model()
        self._screen: Screen | None = None
        self._wants_shot = False
        self._refused = ""
        self._sent: dict[str, Any] = {}
        self._sent_picture = ""

    def __enter__(self) -> Self:
        """Connect and return the panel.

        Raises:
            UsageError: paho-mqtt is not installed, or the broker refuses the user
            PanelDisconnectedError: the broker is not there
        """
        self._client = client = self._new_client()
        self._connected.clear()
        self._refused_by_broker = ""
        host, port = self._broker
        try:
            client.connect(host, port, _KEEP_ALIVE_S)
        except OSError as error:
            untrusted = isinstance(error, ssl.SSLCertVerificationError)
            raise PanelDisconnectedError(
                f"cannot reach the broker at {host}:{port}: {error.strerror or error}",
                hint="name the certificate of its authority in SSL_CERT_FILE"
                if untrusted
                else "check its address, and that it runs",
            ) from error
        client.loop_start()
        answered = self._connected.wait(_CONNECT_S)
        if self._refused_by_broker or not answered:
            client.loop_stop()
        if self._refused_by_broker:
            raise UsageError(
                f"the broker at {host}:{port} refuses the menu: {self._refused_by_broker}",
                hint=f"set {USER_VARIABLE} and {PASSWORD_VARIABLE}",
            )
        if not answered:
            raise PanelDisconnectedError(
                f"nothing answers as a broker at {host}:{port}", hint="check its address"
            )
        return self

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Say that the menu has ended, and disconnect."""
        client, self._client = self._client, None
        if client is not None:
            if client.is_connected():
                client.publish(
                    topic(self._name, "availability"), OFFLINE, 1, True
                ).wait_for_publish(2)
            client.disconnect()
            client.loop_stop()
        self._sent, self._sent_picture = {}, ""

    def show_model(self, model: Model) -> None:
        """Take the state whose screen is shown next; a capture asked for goes on by itself."""
        if model.state is not self._model.state:
            self._refused = ""
            is_on_the_way = bool(self._keys) or model.state in (State.PLANNING, State.REVIEW)
            self._wants_shot &= is_on_the_way
        self._model = model
        if self._wants_shot and model.state is State.REVIEW:
            self._wants_shot = False
            self._do("shoot")

    def show(self, screen: Screen) -> int:
        """Publish the state where it has changed, and the picture of a new result."""
        self._screen = screen
        state = state_message(self._model, screen, self._refused)
        if state != self._sent:
            self._sent = state
            self._client.publish(topic(self._name, "state"), json.dumps(state), 1, True)
        if self._model.state is State.RESULT and screen.folder != self._sent_picture:
            self._sent_picture = screen.folder
            if picture := _picture(Path(screen.folder)):
                self._client.publish(topic(self._name, "picture"), picture, 1, True)
        return 0

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key on the way to what was asked for.

        Without time to wait no command is taken: those keys may be discarded.
        """
        if not self._keys and timeout_s:
            try:
                command = self._commands.get(timeout=timeout_s)
            except queue.Empty:
                return None
            self._do(command)
        return self._keys.popleft() if self._keys else None

    def _do(self, command: str) -> None:
        """Find the keys that do a command; one that is not possible now is stated as refused."""
        found = (keys_for(self._model, each) for each in _COMMANDS[command])
        self._keys.extend(next(filter(None, found), ()))
        self._wants_shot = command == "shoot" and self._model.state is not State.REVIEW
        if not self._keys:
            self._wants_shot, self._refused = False, command
            if self._screen is not None:
                self.show(self._screen)

    def _new_client(self) -> Any:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as error:
            raise UsageError(
                "the panel mqtt needs paho-mqtt", hint="pip install 'camctl[mqtt]'"
            ) from error
        client = Client(CallbackAPIVersion.VERSION2)
        user = os.environ.get(USER_VARIABLE)
        if user:
            client.username_pw_set(user, os.environ.get(PASSWORD_VARIABLE))
        if self._has_tls:
            client.tls_set()
        client.will_set(topic(self._name, "availability"), OFFLINE, 1, True)
        client.on_connect, client.on_message = self._on_connect, self._on_message
        return client

    def _on_connect(self, client: Any, _: object, __: object, reason: Any, ___: object) -> None:
        """Say that the menu is there, at first and after the broker was away."""
        if reason.is_failure:
            self._refused_by_broker = str(reason)
        else:
            client.subscribe(topic(self._name, "command"), 1)
            discovery = json.dumps(discovery_message(self._name))
            client.publish(discovery_topic(self._name), discovery, 1, True)
            client.publish(topic(self._name, "availability"), ONLINE, 1, True)
        self._connected.set()

    def _on_message(self, _: object, __: object, message: Any) -> None:
        """Take a command; what is none, and retained ones of the past, are left out."""
        command = message.payload.decode("ascii", "replace").strip()
        if command in COMMANDS and not message.retain and not self._commands.full():
            self._commands.put_nowait(command)


def _picture(folder: Path) -> bytes:
    """Return the preview of a capture, a PNG file; b"" where there is none, or it is too large."""
    from camctl.pictures.files import PREVIEW

    path = folder / PREVIEW
    try:
        return path.read_bytes() if path.stat().st_size <= _MOST_PICTURE_BYTES else b""
    except OSError:
        return b""
