"""The faults of the fault table, and the state that is safe after each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """A fault: a title, where it is made and by which name, the safe state, and words of the
    operator's text.

    `where`: "start" (on the bench, before the loop begins), "bench", "loop" or "signal". `safe`:
    "run" (with the words of a warning, if there are any), "hold", "stop", or "gone": the process
    has ended and torque is off. It swims for `after` seconds before the fault.
    """

    title: str
    where: str
    name: str
    safe: str
    words: str = ""
    after: float = 0.8


CASES = (
    Case("servo's cable pulled, later put back", "bench", "servo cable", "stop", "no servo for"),
    Case("IMU's cable pulled", "bench", "imu cable", "hold", "no yaw rate for"),
    Case("camera gone: poses stop", "bench", "no poses", "hold", "no pose for"),
    Case("link cut both ways", "bench", "link cut", "hold", "no pose for"),
    Case("30 % of datagrams lost", "bench", "loss", "run"),
    Case("datagrams swapped in pairs", "bench", "reordering", "run"),
    Case("old datagrams again", "bench", "replays", "run"),
    Case("20 forged datagrams to each true one", "bench", "forgeries", "run"),
    Case("one IMU spike of 20 rad/s", "bench", "one spike", "run"),
    Case("IMU spikes in every second reading", "bench", "spikes", "run"),
    Case("IMU's numbers stand still", "bench", "imu frozen", "hold", "numbers do not change"),
    Case("servo's encoder stands still", "bench", "encoder frozen", "stop", "does not follow"),
    Case("servo restarts, RAM lost", "bench", "servo restarts", "stop", "lost its torque"),
    Case("servo at 66 deg C", "bench", "warm", "hold", "servo at 66"),
    Case("servo at 76 deg C", "bench", "hot", "stop", "servo at 76"),
    Case("servo shut down, overheated", "bench", "overheated", "stop", "hardware error"),
    Case("supply sags to 9.7 V", "bench", "voltage sags", "hold", "supply 9.7 V"),
    Case("supply sags to 9.0 V", "bench", "voltage fails", "stop", "hardware error"),
    Case("one sample of 9.7 V", "bench", "voltage dips", "run"),
    Case("servo's bus watchdog latched", "bench", "watchdog", "hold", "own watchdog"),
    Case("station's clock jumps 5 s ahead", "bench", "clock ahead", "hold", "clock jumped"),
    Case("station's clock jumps 5 s back", "bench", "clock back", "hold", ""),
    Case("tag read the wrong way round", "bench", "turned round", "hold", "poses in a row"),
    Case("poses 0.6 m off at once", "bench", "elsewhere", "hold", "poses in a row"),
    Case("tail reversed from the start", "start", "tail reversed", "stop", "wrong side"),
    Case("camera's picture mirrored", "start", "picture mirrored", "stop", "mirrored"),
    Case("tag turned by 90 degrees", "start", "tag askew", "stop", "turn the tag"),
    Case("IMU upside down", "start", "imu upside down", "stop", "upside down"),
    Case("tendon cut before the start", "start", "tendon snapped", "stop", "does not answer"),
    Case("left tendon cut before the start", "start", "left tendon cut", "stop", "the left tendon"),
    Case(
        "right tendon cut before the start", "start", "right tendon cut", "stop", "the right tendon"
    ),
    Case("half stroke from the start", "start", "half stroke", "stop", "servo obeys"),
    Case("fish held at the start", "start", "held still", "stop", "does not answer"),
    Case("encoder shows 20 % from the start", "start", "encoder 20 %", "stop", "of the stroke"),
    Case("tendon snaps", "bench", "tendon snapped", "hold", "tendons", 3.0),
    Case("left tendon cut", "bench", "left tendon cut", "hold", "tendon", 3.0),
    Case("right tendon cut", "bench", "right tendon cut", "hold", "tendon", 3.0),
    Case("encoder shows 30 %", "bench", "encoder 30 %", "hold", "check servo", 3.0),
    Case("half stroke", "bench", "half stroke", "hold", "check servo", 3.0),
    Case("horn slips: half the tail's stroke", "bench", "horn slips", "hold", "tendons", 3.0),
    Case("fish held still", "bench", "held still", "hold", "answers its tail", 3.0),
    Case("pose frozen under fresh stamps", "bench", "pose frozen", "hold", "exactly equal", 3.0),
    Case("target jumps at every frame", "bench", "target jumps", "hold", "target jumps", 3.0),
    Case(
        "camera drifts, 1 cm/s and 0.02 rad/s",
        "bench",
        "camera drifts",
        "run",
        "camera turns",
        10.0,
    ),
    Case("IMU biased by 0.5 rad/s", "bench", "imu biased", "hold", "IMU and camera", 3.0),
    Case("IMU turned over on the way", "bench", "imu upside down", "hold", "IMU", 3.0),
    Case("picture mirrored on the way", "bench", "picture mirrored", "hold", ""),
    Case("places mirrored, headings not", "bench", "places mirrored", "hold", "off its", 3.0),
    Case("policy gives NaN", "loop", "nan", "hold", "not a number"),
    Case("loop late by 25 ms in every period", "loop", "overrun", "hold", "periods missed"),
    Case("loop hangs", "loop", "hang", "gone"),
    Case("an exception in the loop", "loop", "exception", "gone"),
    Case("disk full", "loop", "disk full", "hold", "log cannot be written"),
    Case("watchdog killed with -9", "loop", "no watchdog", "stop", "watchdog process"),
    Case("watchdog stopped (hangs)", "loop", "stopped watchdog", "stop", "watchdog process"),
    Case("watchdog stopped, then the loop killed", "loop", "both", "gone"),
    Case("killed with -9", "signal", "SIGKILL", "gone"),
    Case("stopped with Ctrl-Z", "signal", "SIGSTOP", "gone"),
    Case("SIGTERM", "signal", "SIGTERM", "stop", "stop asked by"),
    Case("Ctrl-C", "signal", "SIGINT", "stop", "stop asked by"),
)
