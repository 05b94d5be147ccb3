"""The emulated bench with the robot's loop and its operator page, all in threads of this process.

Rig and loop share an interpreter with the test, so limits are wide. What the page asks for is
looked up where it ends: in the frames that the fish got and in its servo.
"""

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import websockets.sync.client as ws

from lines import XW430
from support import until
from tailbeat.control.policy import load_policy
from tailbeat.emulators import rig as bench
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.status import State
from tailbeat.operator.client import OperatorClient, open_client, turn
from tailbeat.robot.devices import Devices
from tailbeat.robot.dynamixel_tables import X
from tailbeat.robot.imu import connect as connect_imu
from tailbeat.robot.loop import Loop
from tailbeat.robot.safety import SafetyLimits
from tailbeat.robot.servo import connect as connect_servo

KEY, ROOM, TAG = bytes(32), (5.5, 2.7), (1.5, 0.5)
FISH, POLICY = load_fish("pulley-fish"), load_policy("pulley-fish-pool-generator")
WIDE = SafetyLimits(pose_hold=9.0, pose_stop=15.0, imu_hold=9.0, servo_hold=9.0, servo_stop=15.0,
              clock_doubt=2.0, overruns_hold=10**6)  # fmt: skip
PATIENT = 4.0  # s for a reply of servo or IMU: their thread waits for a processor
SOON = 40.0  # s: what takes a tenth of a second may take that on a busy machine
# A picture to be found again: one grey pixel.
JPEG = bytes.fromhex(
    "ffd8ffe000104a46494600010100000100010000ffdb004300" + "08" * 64 + "ffc0000b080001000101011100"
    "ffc4001f0000010501010101010100000000000000000102030405060708090a0b"
    "ffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1"
    "c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a6364"
    "65666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9"
    "bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
    "ffda0008010100003f00fbd0ffd9"
)


@dataclass
class Lab:
    """A loop that ticks, the rig under it, and the rig's operator page."""

    loop: Loop
    rig: bench.Rig
    client: OperatorClient
    picture: bytes = b""

    @property
    def torque(self) -> int:
        return self.rig.servo.get(64)

    @property
    def target(self) -> tuple[float, float] | None:
        """The one that the fish got."""
        frames = self.loop.devices.receiver.frames
        return frames[0].target if frames else None

    @property
    def page(self) -> str:
        return self.client.url.partition("#")[0]

    def order(self, **words: Any) -> None:
        """As a page with the token does; the server answers in turn, so it has taken it."""
        with ws.connect(live(self)) as page:
            page.send(json.dumps({"token": self.client.token, **words}))
            assert ask(page, do="hello", token=self.client.token) == "token accepted"

    def bring(self, word: str, state: State, give: Callable[[], None] | None = None) -> None:
        """Order until it is so, as an operator does: a busy machine may lose or refuse an order."""
        for _ in range(5):
            give() if give else self.order(do=word)
            with contextlib.suppress(AssertionError):
                self.stands(state, SOON / 5)
                return
        self.stands(state, 0.0)

    def rest(self) -> None:
        """Back to a disarmed fish that follows its tag."""
        self.bring("disarm", State.DISARMED)
        self.order(do="tag")
        until(lambda: near(self, *TAG))

    def swim(self) -> None:
        self.rest()
        for word, state in (("arm", State.ARMED), ("swim", State.RUN)):
            self.bring(word, state)

    def stands(self, state: State, seconds: float = SOON) -> None:
        now = lambda: self.loop.safety_status  # noqa: E731
        until(lambda: now().state is state, what=now, seconds=seconds)


@contextmanager
def open_lab() -> Iterator[Lab]:
    """A rig, its operator page, and a loop that ticks, until the end of the block."""
    heard = link.bind("127.0.0.1", 0)
    rig = bench.open_rig(FISH, KEY, heard.getsockname(), TAG)
    rig.shaft.advance(0.0, 0.01)
    client, ended = open_client(("127.0.0.1", 0), ROOM), threading.Event()
    made = Lab(None, rig, client)  # type: ignore[arg-type]

    def over() -> bool:
        turn(client, rig.station.sender, FISH, time.monotonic(), picture=made.picture)
        return ended.is_set()

    def tick() -> None:
        while not ended.is_set():
            made.loop.tick(time.monotonic())
            time.sleep(0.02)

    serving = threading.Thread(target=bench.serve, args=(rig, over), daemon=True)
    serving.start()
    servo, imu = (
        connect_servo(rig.ports[0], XW430, deadline=PATIENT),
        connect_imu(rig.ports[1], None, PATIENT),
    )
    imu.prepare()
    arming = servo.arm

    def armed(watchdog: float = 0.1) -> float:
        """Without the servo's own watchdog: a thread may be late by more than it can wait."""
        held = arming()
        servo.set(X.bus_watchdog, 0)
        return held

    servo.arm = armed  # type: ignore[method-assign]
    receiver = link.Receiver(KEY, ROOM)
    devices = Devices(servo, imu, receiver, heard, rig.station.socket.getsockname())
    made.loop = Loop(POLICY, devices, lambda row: None, WIDE, sign_test=False)
    ticking = threading.Thread(target=tick, daemon=True)
    ticking.start()
    until(lambda: receiver.clock.offset(0) is not None and made.loop.poses.seen)
    yield made
    ended.set()
    for thread in (ticking, serving):
        thread.join(10)
    servo.close()
    imu.close()
    client.close()
    bench.close_rig(rig)
    heard.close()


def near(lab: Lab, x: float, y: float) -> bool:
    at = lab.target
    return at is not None and abs(at[0] - x) < 0.03 and abs(at[1] - y) < 0.03


def live(lab: Lab) -> str:
    return f"{lab.page.replace('http', 'ws')}live"


def ask(page: ws.ClientConnection, **words: Any) -> str:
    """What the server says to a command."""
    page.send(json.dumps(words))
    end = time.monotonic() + SOON
    while time.monotonic() < end:
        message = json.loads(page.recv(SOON))
        page.send("drawn")
        if message["said"]:
            return message["said"][0]
    raise AssertionError("no answer")
