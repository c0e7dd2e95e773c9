"""The menu on a real broker, mosquitto, with another client that does what Home Assistant does."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from panel_fakes import FakeJob

from camctl.errors import UsageError
from camctl.menu.app import run
from camctl.menu.mqtt.panel import PASSWORD_VARIABLE, USER_VARIABLE, MqttPanel
from camctl.menu.mqtt.topics import discovery_message
from camctl.menu.ports import PanelDisconnectedError

mqtt: Any = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
MOSQUITTO = shutil.which("mosquitto", path="/usr/local/sbin:/usr/sbin:/usr/bin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="apt-get install mosquitto")
WAIT_S = 20.0
COMMAND = "camctl/hall/command"


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


@contextmanager
def broker(folder: Path, port: int, lines: str = "allow_anonymous true") -> Iterator[None]:
    """Run mosquitto while the block runs."""
    configuration = folder / f"mosquitto-{port}.conf"
    configuration.write_text(f"listener {port} 127.0.0.1\nuser root\n{lines}\n")
    with subprocess.Popen([str(MOSQUITTO), "-c", str(configuration)]) as process:
        try:
            for _ in range(200):
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.02)
            yield
        finally:
            process.terminate()


class Client:
    """What Home Assistant has received, topic by topic."""

    def __init__(self, port: int) -> None:
        self.received: list[tuple[str, bytes]] = []
        self._changed = threading.Condition()
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.subscribe("#", 1)
        self._client.loop_start()

    def _on_message(self, _: object, __: object, message: Any) -> None:
        with self._changed:
            self.received.append((message.topic, message.payload))
            self._changed.notify_all()

    def send(self, command: str) -> None:
        self._client.publish(COMMAND, command, 1).wait_for_publish(WAIT_S)

    def wait_for(self, topic: str, accepts: Callable[[bytes], object], after: int = 0) -> int:
        """Return how many messages there were when one that is accepted had come."""
        found: list[int] = []

        def has_come() -> bool:
            places = enumerate(self.received[after:], after + 1)
            found[:] = [n for n, (name, data) in places if name == topic and accepts(data)]
            return bool(found)

        with self._changed:
            assert self._changed.wait_for(has_come, WAIT_S), "\n".join(map(repr, self.received))
        return found[0]

    def wait_for_state(self, state: str, after: int = 0) -> int:
        def accepts(data: bytes) -> bool:
            return bool(json.loads(data)["state"] == state)

        return self.wait_for("camctl/hall/state", accepts, after)

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    found = free_port()
    with broker(tmp_path, found):
        yield found


@pytest.fixture
def home(port: int) -> Iterator[Client]:
    client = Client(port)
    yield client
    client.stop()


@contextmanager
def menu(panel: MqttPanel, job: FakeJob) -> Iterator[None]:
    """Run the menu on a thread while the block runs; it is ended as by a key."""
    thread = threading.Thread(target=run, args=(panel, lambda: job))
    thread.start()
    try:
        yield
    finally:
        from camctl.menu.model import Action, State
        from camctl.menu.mqtt import panel as module
        from camctl.menu.studio.commands import Command

        quitting = Command(state=State.CONFIRM, action=Action.QUIT)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(module._COMMANDS, "quit", (quitting,))
            while thread.is_alive():
                panel._commands.put("quit")
                thread.join(0.2)


@needs_mosquitto
def test_shoot_leads_to_a_picture_and_states_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int, home: Client
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "captures/x").mkdir(parents=True)
    (tmp_path / "captures/x/preview.png").write_bytes(b"the picture")
    job = FakeJob()
    with menu(MqttPanel(f"127.0.0.1:{port},name=hall"), job):
        home.wait_for_state("idle")
        for expected in (1, 2):  # the second one from the result of the first
            now = len(home.received)
            home.send("shoot")
            now = home.wait_for_state("shooting", now)
            home.wait_for_state("result", now)
            assert len(job.shot) == expected
        home.wait_for("camctl/hall/picture", lambda data: data == b"the picture")
        home.wait_for("homeassistant/device/camctl-hall/config", lambda data: b"platform" in data)
    last = json.loads([data for name, data in home.received if name == "camctl/hall/state"][-2])
    assert last["folder"] == "captures/x"
    assert (last["levels"], last["clipped"], last["trustworthy"]) == (97.0, 0.31, True)
    home.wait_for("camctl/hall/availability", lambda data: data == b"offline")


@needs_mosquitto
def test_series_is_taken_and_cancelled_and_what_is_impossible_is_refused(
    port: int, home: Client
) -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    with menu(MqttPanel(f"127.0.0.1:{port},name=hall"), job):
        now = home.wait_for_state("idle")
        home.send("cancel")
        now = home.wait_for(
            "camctl/hall/state", lambda data: json.loads(data)["refused"] == "cancel", now
        )
        home.send("unknown")
        home.send("series")
        now = home.wait_for_state("series_shooting", now)
        home.send("shoot")
        now = home.wait_for(
            "camctl/hall/state", lambda data: json.loads(data)["refused"] == "shoot", now
        )
        home.send("cancel")
        home.wait_for_state("cancelled", now)
        assert len(job.series_taken) == 1
        assert not job.shot


@needs_mosquitto
def test_broker_says_that_the_menu_is_gone_until_it_is_back(port: int, home: Client) -> None:
    panel = MqttPanel(f"127.0.0.1:{port},name=hall")
    topic = "camctl/hall/availability"
    with panel:
        now = home.wait_for(topic, lambda data: data == b"online")
        panel._client.socket().shutdown(socket.SHUT_RDWR)  # as where the power fails
        now = home.wait_for(topic, lambda data: data == b"offline", now)
        home.wait_for(topic, lambda data: data == b"online", now)


@needs_mosquitto
def test_broker_that_wants_a_password_gets_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    passwords = tmp_path / "passwords"
    subprocess.run(
        ["mosquitto_passwd", "-b", "-c", str(passwords), "camera", "secret"],
        check=True,
        capture_output=True,
    )
    passwords.chmod(0o600)
    with broker(tmp_path, port, f"allow_anonymous false\npassword_file {passwords}"):
        with pytest.raises(UsageError, match=r"refuses the menu: Not authorized; set CAMCTL_MQTT_"):
            MqttPanel(f"127.0.0.1:{port}").__enter__()
        monkeypatch.setenv(USER_VARIABLE, "camera")
        monkeypatch.setenv(PASSWORD_VARIABLE, "secret")
        with MqttPanel(f"127.0.0.1:{port}") as panel:
            assert panel._client.is_connected()


def certificates(folder: Path) -> Path:
    """Return the certificate of an authority, which signed broker.pem for 127.0.0.1."""
    authority = ("-CA", "authority.pem", "-CAkey", "authority.key")
    for name, subject, more in (
        ("authority", "/CN=own authority", ()),
        ("broker", "/CN=broker", (*authority, "-addext", "subjectAltName=IP:127.0.0.1")),
    ):
        new = ("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256")
        files = ("-nodes", "-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", subject)
        subprocess.run([*new, *files, *more], cwd=folder, check=True, capture_output=True)
    return folder / "authority.pem"


@needs_mosquitto
@pytest.mark.filterwarnings("ignore:.*SSLSocket")  # paho leaves one where the handshake fails
@pytest.mark.skipif(shutil.which("openssl") is None, reason="apt-get install openssl")
def test_connection_is_encrypted_and_the_broker_is_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority, port, tls_port = certificates(tmp_path), free_port(), free_port()
    lines = (
        f"allow_anonymous true\nlistener {tls_port} 127.0.0.1\n"
        f"certfile {tmp_path}/broker.pem\nkeyfile {tmp_path}/broker.key"
    )
    address = f"127.0.0.1:{tls_port},name=hall,tls=1"
    with broker(tmp_path, port, lines):
        client = Client(port)
        with pytest.raises(PanelDisconnectedError, match=r"verify failed.*SSL_CERT_FILE"):
            MqttPanel(address).__enter__()
        monkeypatch.setenv("SSL_CERT_FILE", str(authority))
        with MqttPanel(address) as panel:
            assert panel._client.socket().version().startswith("TLS")
            client.wait_for("camctl/hall/availability", lambda payload: payload == b"online")
        with pytest.raises(PanelDisconnectedError):
            MqttPanel(f"127.0.0.1:{port},tls=1").__enter__()
        client.stop()


def test_discovery_has_what_home_assistant_requires() -> None:
    """Its schema of device discovery: homeassistant/components/mqtt/schemas.py, 2025."""
    message = discovery_message("hall")
    assert set(message) == {"device", "origin", "components", "availability_topic"}
    assert message["device"]["identifiers"]
    assert message["origin"]["name"]
    required = {"button": "command_topic", "sensor": "state_topic", "image": "image_topic"}
    identities, presses = set(), set()
    for component in message["components"].values():
        assert component[required[component["platform"]]].startswith("camctl/hall/")
        identities.add(component["unique_id"])
        presses.add(component.get("payload_press"))
        if component.get("device_class") == "battery":
            assert component["unit_of_measurement"] == "%"
    assert len(identities) == len(message["components"])
    assert presses == {"shoot", "series", "cancel", None}


def test_broker_that_is_not_there_is_one_line() -> None:
    with pytest.raises(
        PanelDisconnectedError, match=r"^cannot reach the broker at 127.0.0.1:\d+: C"
    ):
        MqttPanel(f"127.0.0.1:{free_port()}").__enter__()


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("", "invalid address ''"),
        ("host:99999", "invalid address"),
        ("host,name=a/b", "invalid address"),
        ("host,nme=a", "unknown option of the panel 'nme'; did you mean name"),
        ("host,tls=x", "invalid tls=x"),
    ],
)
def test_invalid_address_is_refused(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        MqttPanel(address)
