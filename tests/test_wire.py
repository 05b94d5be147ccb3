"""Serial lines: how they are opened, and opened again after a cable was out."""

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

import serial

from tailbeat.emulators.line import close_line, open_line
from tailbeat.robot import imu, wire


def test_every_port_is_asked_for_no_delay_and_again_after_the_cable_was_out(monkeypatch):
    """An adapter without it holds bytes back for 16 ms, and no reply comes within 5 ms."""
    asked = list[str]()
    monkeypatch.setattr(
        serial.Serial, "set_low_latency_mode", lambda port, on: asked.append(port.port)
    )
    line = open_line()
    servo = wire.open_port(line.path, 1_000_000, 0.1)
    assert asked == [line.path]
    wire.reopen(servo)
    assert asked == [line.path] * 2
    servo.close()
    imu.opened(line.path, 0.1).close()
    assert asked == [line.path] * 3
    close_line(line)
