"""A check's finding: verdict, value, and what to do."""

from dataclasses import dataclass

OK, WARN, BAD = "ok", "warn", "bad"
ADVICE = {
    "servo answers": "check its power and cable; tailbeat prepare finds it at any id and rate",
    "servo": "check its cable; try another cable",
    "servo firmware": "update it with its maker's program (Dynamixel Wizard)",
    "servo supply": "charge or replace the battery",
    "servo temperature": "let it cool; check that the tail is not jammed",
    "servo hardware error": "remove the cause, then switch the servo off and on",
    "servo torque": "tailbeat torque-off --servo PORT",
    "servo stopped itself": "nothing: arming clears it",
    "servo mode": "nothing: arming sets it to 3, position",
    "servo return delay": "nothing: arming sets it to 0",
    "servo limits": "2048, the straight tail, lies outside them; tailbeat prepare sets the fish's",
    "servo drive mode": "reversed, or goals turn torque on: tailbeat prepare sets register 10",
    "servo homing offset": "the straight tail is 2048: tailbeat prepare sets register 20 to 0",
    "servo shutdown": "overload does not turn torque off: tailbeat prepare sets register 63",
    "servo turns": "positions beyond one turn: tailbeat prepare clears bit 4 of register 18",
    "servo phase": "reversed: restore bits 0 and 7 of register 18 with its maker's program (FD)",
    "servo unloading": "overload does not turn torque off: tailbeat prepare sets register 19",
    "servo reading time": "latency timer 1 ms, return delay 0, 1000000 baud, no USB hub",
    "IMU answers": "check cable, power and mode pins; free a Pi's UART: raspi-config",
    "IMU": "switch it off and on; check its cable",
    "IMU's own error": "switch it off and on; the number is SYS_ERR of its data sheet",
    "IMU mode": "it does not accept its mode: switch it off and on",
    "IMU mounting": "hold the fish level; else correct hardware.imu_up in its file, give --fish",
    "IMU readings": "the sensor is busy, or its cable is bad; use its UART, not I2C",
    "IMU at rest": "hold the fish still and check again; else the yaw rate has this error",
    "key": "run tailbeat key NEW.key, copy it to both machines, chmod 600",
    "station answers": "start the station; check the address, the firewall, the same key on both",
    "clocks compared": "slow network: use an own access point, iw dev wlan0 set power_save off",
    "poses": "uncover the camera; put the fish's tag in view",
    "poses per second": "shorten the exposure, or use a faster station",
    "datagrams lost": "antenna above water, Wi-Fi power save off, a Wi-Fi channel of your own",
    "pose age": "the camera queues frames, or the network is slow",
    "fish seen": "show its tag whole in view and without glare",
    "target seen": "put the target's tag in view, or give drive --target x,y",
    "disk": "choose a folder you may write to, or delete old logs: 250 MB an hour",
    "real-time priority": "run it as a service (tailbeat unit), or allow rtprio 40 in limits.conf",
    "locked memory": "run it as a service (tailbeat unit), or memlock unlimited in limits.conf",
    "processor's clock": "cpupower frequency-set -g performance",
    "wireless": "antenna above water; iw dev wlan0 set power_save off",
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One finding. `verdict` is "ok", "warn" (the robot may swim badly) or "bad" (it cannot
    swim)."""

    name: str
    verdict: str
    found: str
    do: str = ""


def finding(name: str, found: str, bad: bool = False, warn: bool = False, do: str = "") -> Finding:
    """Make a finding; where it is not ok, with what to do."""
    verdict = BAD if bad else WARN if warn else OK
    return Finding(name, verdict, found, "" if verdict == OK else do or ADVICE[name])
