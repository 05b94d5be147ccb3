"""The faults of the fault table, and the state that is safe after each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """A fault: a title, where it is made ("bench", "loop" or "signal") and by which name, the safe
    state ("run", "hold", "stop", or "gone": the process has ended and torque is off), and words of
    the operator's text."""

    title: str
    where: str
    name: str
    safe: str
    words: str = ""


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
    Case("policy gives NaN", "loop", "nan", "hold", "not a number"),
    Case("loop late by 25 ms in every period", "loop", "overrun", "hold", "periods missed"),
    Case("loop hangs", "loop", "hang", "gone"),
    Case("an exception in the loop", "loop", "exception", "gone"),
    Case("disk full", "loop", "disk full", "hold", "log cannot be written"),
    Case("watchdog killed with -9", "loop", "no watchdog", "hold", "watchdog process has ended"),
    Case("killed with -9", "signal", "SIGKILL", "gone"),
    Case("stopped with Ctrl-Z", "signal", "SIGSTOP", "gone"),
    Case("SIGTERM", "signal", "SIGTERM", "stop", "stop asked by"),
    Case("Ctrl-C", "signal", "SIGINT", "stop", "stop asked by"),
)
