"""What a check found: a verdict, the value, and what to do about it."""

from dataclasses import dataclass

OK, WARN, BAD = "ok", "warn", "bad"
ADVICE = {
    "servo answers": "check its power (12 V), cable and id; scan with the maker's Dynamixel Wizard",
    "servo": "check its cable; try another one",
    "servo firmware": "update it with the maker's Dynamixel Wizard",
    "servo supply": "charge or replace the battery; 12 V is meant",
    "servo temperature": "let it cool; is the tail jammed?",
    "servo hardware error": "find the reason, then switch the servo off and on",
    "servo torque": "tailbeat torque-off --servo PORT",
    "servo stopped itself": "nothing: arming clears it",
    "servo mode": "nothing: arming sets it to 3, position",
    "servo return delay": "nothing: arming sets it to 0",
    "servo limits": "2048, straight, must lie between: set registers 48 and 52",
    "servo drive mode": "reversed: set register 10 to 0 with the maker's Wizard",
    "servo homing offset": "set register 20 to 0: the straight tail is 2048",
    "servo shutdown": "overload does not take the torque away: set register 63 to 52",
    "servo reading time": "latency timer 1 ms, return delay 0, 1000000 baud, no hub in between",
    "IMU answers": "check cable, power and PS1 (high for UART); free a Pi's UART: raspi-config",
    "IMU": "switch it off and on; check its cable",
    "IMU's own error": "switch it off and on; the number is SYS_ERR of its data sheet",
    "IMU mode": "it does not take its mode: switch it off and on",
    "IMU readings": "busy, or a bad cable; use its UART, not I2C",
    "IMU at rest": "hold the fish still and ask again; else it is off by so much",
    "key": "tailbeat key NEW.key, copied to both machines, chmod 600",
    "station answers": "is the tracker running there? same key on both, address, firewall",
    "clocks compared": "a slow network: own access point, iw dev wlan0 set power_save off",
    "poses": "is the camera covered, or the fish's tag out of view?",
    "poses per second": "exposure too long, or the station too slow",
    "datagrams lost": "antenna under water? Wi-Fi power save? a channel of your own",
    "pose age": "the camera queues frames, or the network is slow",
    "fish seen": "its tag must lie in view, whole and without glare",
    "target seen": "float the target's tag, or give drive --target x,y",
    "disk": "choose a folder you may write to, or delete old logs: 120 MB an hour",
    "real-time priority": "start it from a unit (tailbeat unit), or allow rtprio 40 in limits.conf",
    "locked memory": "start it from the unit (tailbeat unit), or memlock unlimited in limits.conf",
    "processor's clock": "cpupower frequency-set -g performance",
    "wireless": "antenna above water; iw dev wlan0 set power_save off",
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One answer: `verdict` is "ok", "warn" (it may swim, and badly) or "bad" (it will not)."""

    name: str
    verdict: str
    found: str
    do: str = ""


def finding(name: str, found: str, bad: bool = False, warn: bool = False, do: str = "") -> Finding:
    """A finding, with what to do about it where it is not well."""
    verdict = BAD if bad else WARN if warn else OK
    return Finding(name, verdict, found, "" if verdict == OK else do or ADVICE[name])
