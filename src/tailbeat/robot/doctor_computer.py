"""Checks of the robot's computer: disk, rights, processor clock, wireless."""

import os
import resource
import shutil
from pathlib import Path

from tailbeat.robot.findings import Finding, finding

ROOM_WARN, ROOM_BAD = 2e9, 2e8  # bytes: a log takes about 250 MB an hour


def check_disk(folder: Path) -> Finding:
    """Check the free space for the log."""
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        return finding("disk", f"{folder}: not a writable folder", bad=True)
    free = shutil.disk_usage(folder).free
    return finding("disk", f"{free / 1e9:.1f} GB free", bad=free < ROOM_BAD, warn=free < ROOM_WARN)


def check_scheduling() -> list[Finding]:
    """Whether real-time priority and locked memory are allowed."""
    root, most = os.geteuid() == 0, resource.RLIM_INFINITY
    priority = root or resource.getrlimit(resource.RLIMIT_RTPRIO)[1] != 0
    memory = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    locked = "unlimited" if root or memory == most else f"{memory // 1024} KiB"
    return [
        finding("real-time priority", "allowed" if priority else "not allowed", warn=not priority),
        finding("locked memory", locked, warn=locked != "unlimited"),
    ]


def check_governor(sysfs: Path = Path("/sys/devices/system/cpu")) -> Finding:
    """Whether the processor runs at its highest clock rate."""
    files = sysfs.glob("cpu[0-9]*/cpufreq/scaling_governor")
    found = sorted({file.read_text().strip() for file in files})
    slow = bool(found) and found != ["performance"]
    return finding("processor's clock", ", ".join(found) or "fixed", warn=slow)


def check_wireless(proc: Path = Path("/proc/net/wireless")) -> Finding:
    """Whether a wireless link may carry the poses, and how strong it is."""
    rows = proc.read_text().splitlines()[2:] if proc.is_file() else []
    if not rows:
        return finding("wireless", "none")
    name, level = rows[0].split(":")[0].strip(), float(rows[0].split()[3])
    return finding("wireless", f"{name}: {level:.0f} dBm", bad=level < -80, warn=level < -67)
