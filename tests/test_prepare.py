"""`tailbeat prepare` over real bytes: it finds a servo, compares, asks, writes and reads back."""

import json
import os
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, STS3215, XW430, Bench, served, servo_bench, sts_fish
from support import command, complaint, tailbeat, until
from tailbeat.emulators.servo import Dynamixel, Faults, serve
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.robot import prepare
from tailbeat.robot.servo import connect

pytestmark = pytest.mark.realtime

FISH = load_fish("pulley-fish")
STS_FISH = FISH.model_copy(update={"hardware": STS3215})
LOW, HIGH = 2048 - 910, 2048 + 910  # counts of -80 and 80 degrees, the fish's range
STRANGE = {7: 7, 8: 1, 9: 250, 10: 1, 11: 4, 20: 300, 52: 0, 48: 4095, 63: 0, 68: 1, 112: 40}
STRANGE_STS = {5: 7, 6: 4, 7: 250, 8: 0, 9: 0, 11: 0, 18: 12 | 16, 19: 0, 33: 1, 41: 50}


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """One servo answers at once; a real bus is listened to for longer."""
    monkeypatch.setitem(prepare.LISTEN, "dynamixel-x", PATIENT)
    monkeypatch.setitem(prepare.LISTEN, "feetech-sts", PATIENT)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench() as made:
        yield made


@pytest.fixture
def sts() -> Iterator[Bench]:
    with servo_bench(STS3215) as made:
        yield made


def test_a_servo_as_another_program_left_it_becomes_ready(bench):
    for address, value in STRANGE.items():
        bench.device.put(address, value)
    looked = prepare.look(bench.path, FISH)
    assert looked.found == prepare.Found(57_600, 7, 1280)
    assert bench.device.get(10) == 1  # nothing was written
    wrong = {one.name: (one.now, one.wanted) for one in looked.wrong}
    assert wrong["status return level"] == (1, 2) and wrong["drive mode"] == (1, 0)
    assert wrong["homing offset"] == (300, 0) and wrong["lowest position"] == (0, LOW)
    changes = prepare.write(bench.path, FISH, looked)
    assert len(changes) == len(looked.wrong) and all(one.done for one in changes)
    servo = connect(bench.path, XW430, deadline=PATIENT)  # id 1, 1,000,000 baud, level 2
    assert (bench.device.get(52), bench.device.get(48)) == (LOW, HIGH)
    assert bench.device.get(63) == 52 and bench.device.get(112) == 0
    servo.close()
    assert not prepare.look(bench.path, FISH).wrong


def test_a_feetech_servo_becomes_ready_and_stays_so_without_power(sts):
    for address, value in STRANGE_STS.items():
        sts.device.put(address, value)
    looked = prepare.look(sts.path, STS_FISH)
    assert looked.found == prepare.Found(115_200, 7, 777)
    changes = prepare.write(sts.path, STS_FISH, looked)
    assert len(changes) == len(looked.wrong) and all(one.done for one in changes)
    assert sts.device.get(55) == 1  # its lock is closed again
    sts.device.reboot()
    until(lambda: sts.device.now > sts.device.quiet_until)
    connect(sts.path, STS3215, deadline=PATIENT).close()
    assert (sts.device.get(9), sts.device.get(11), sts.device.get(33)) == (LOW, HIGH, 0)
    assert sts.device.get(18) == 12 and sts.device.get(19) == 0b101100


def test_torque_goes_off_first_and_a_negative_offset_is_read_with_its_sign(bench):
    bench.device.put(64, 1)
    bench.device.put(20, -200)
    looked = prepare.look(bench.path, FISH)
    assert ("homing offset", -200) in [(one.name, one.now) for one in looked.wrong]
    assert bench.on
    assert all(one.done for one in prepare.write(bench.path, FISH, looked)) and not bench.on


def test_a_servo_that_answers_pings_alone_is_read_once_it_may_answer(bench):
    bench.device.put(68, 0)
    bench.device.put(10, 1)
    looked = prepare.look(bench.path, FISH)
    assert [(one.name, one.now) for one in looked.wrong] == [("status return level", 0)]
    changes = prepare.write(bench.path, FISH, looked)
    assert "drive mode" in {one.setting.name for one in changes}
    assert bench.device.get(68) == 2 and bench.device.get(10) == 0


@pytest.mark.parametrize(
    ("fish", "register", "code", "baud"),
    [
        (FISH, 8, 6, 4_000_000),
        (FISH, 8, 0, 9_600),
        (STS_FISH, 6, 5, 76_800),
        (STS_FISH, 6, 7, 38_400),
    ],
)
def test_a_servo_is_found_at_unusual_rates(fish, register, code, baud):
    with servo_bench(hardware_of(fish)) as bench:
        bench.device.put(register, code)
        looked = prepare.look(bench.path, fish)
        assert looked.found.baud == baud
        assert [one for one in prepare.write(bench.path, fish, looked) if not one.done] == []
        assert bench.device.baud == 1_000_000


# ---- what goes wrong ----------------------------------------------------------------------------


def test_a_refused_write_is_told(bench):
    bench.device.put(63, 0)
    bench.device.table.registers[63] = bench.device.table.registers[147]  # read-only
    looked = prepare.look(bench.path, FISH)
    (change,) = [
        one for one in prepare.write(bench.path, FISH, looked) if one.setting.name == "shutdown"
    ]
    assert not change.done and change.after == 0 and "access error" in change.said


@pytest.mark.parametrize("pulled", [True, False], ids=["unplugged", "silent"])
def test_a_servo_that_is_lost_in_the_middle_is_one_sentence(bench, pulled):
    bench.device.put(10, 1)
    bench.device.put(11, 4)
    looked = prepare.look(bench.path, FISH)
    written = bench.device.table.write

    def lost(address: int, data: bytes) -> int:
        """The cable is pulled, or its wire breaks, when the operating mode is written."""
        if address == 11 and pulled:
            threading.Thread(target=bench.pull).start()
        elif address == 11:
            bench.device.faults.mute = 10**6
        return written(address, data)

    bench.device.table.write = lost
    with pytest.raises(BadInput, match=r"[1-9] of \d+ registers were written before the servo"):
        prepare.write(bench.path, FISH, looked)


@dataclass
class Two:
    """Two servos on one line."""

    first: Dynamixel
    second: Dynamixel
    faults: Faults = field(default_factory=Faults)
    baud: int = 1_000_000
    return_delay: float = 0.0

    def advance(self, now: float) -> None:
        self.first.advance(now)
        self.second.advance(now)

    def answer(self, data: bytes) -> bytes:
        return self.first.answer(data) + self.second.answer(data)


def test_two_servos_on_a_bus_are_told_apart_and_none_takes_the_other_s_id():
    both = Two(Dynamixel(), Dynamixel())
    both.second.put(7, 4)
    with served(serve, both) as (path, _):
        with pytest.raises(BadInput, match="ids 1, 4 answer at 1000000 baud; give one with --id"):
            prepare.look(path, FISH)
        assert prepare.look(path, FISH, ident=1).found.ident == 1
        with pytest.raises(BadInput, match="another servo has id 1"):
            prepare.look(path, FISH, ident=4)


def test_a_servo_of_another_model_or_none_is_one_sentence(bench):
    with pytest.raises(BadInput, match=r"model number 1280 answers, the fish's STS3215|no servo"):
        prepare.look(bench.path, STS_FISH, baud=1_000_000)
    with pytest.raises(BadInput, match="no servo 9 of ROBOTIS answers at 57600 baud"):
        prepare.look(bench.path, FISH, ident=9, baud=57_600)
    bench.device.put(0, 4000)
    with pytest.raises(BadInput, match=r"Y series.*tailbeat does not support it"):
        prepare.look(bench.path, FISH)


# ---- the verb -----------------------------------------------------------------------------------


def test_without_a_terminal_and_without_yes_nothing_changes(bench):
    bench.device.put(10, 1)
    before = bytes(bench.device.table.bytes[:120])
    said = complaint("prepare", "--servo", bench.path, "--fish", "pulley-fish")
    assert "give --yes" in said and "nothing was changed" in said
    assert bytes(bench.device.table.bytes[:120]) == before


def test_with_yes_it_writes_and_reports(bench, tmp_path):
    bench.device.put(7, 3)
    bench.device.put(10, 1)
    words = ("prepare", "--servo", bench.path, "--fish", "pulley-fish", "--yes")
    done = tailbeat(*words, "--json", tmp_path / "a.json")
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "a.json").read_text())
    assert told["ready"] and told["found"] == {"baud": 1_000_000, "ident": 3, "number": 1280}
    written = {one["name"]: (one["before"], one["after"]) for one in told["written"]}
    assert written["id"] == (3, 1) and written["drive mode"] == (1, 0)
    again = tailbeat(*words)
    assert again.returncode == 0 and "nothing had to be changed" in again.stdout


@pytest.mark.parametrize(("answer", "code", "drive"), [(b"n\n", 1, 1), (b"y\n", 0, 0)])
def test_at_a_terminal_it_asks(bench, answer, code, drive):
    bench.device.put(10, 1)
    ours, theirs = os.openpty()
    words = command("prepare", "--servo", bench.path, "--fish", "pulley-fish", "--id", 1)
    with subprocess.Popen(words, stdin=theirs, stdout=subprocess.PIPE, text=True) as process:
        os.write(ours, answer)
        said, _ = process.communicate(timeout=120)
    os.close(ours)
    os.close(theirs)
    assert process.returncode == code, said
    assert "write" in said and bench.device.get(10) == drive


def test_a_refusal_is_exit_code_1(bench, tmp_path):
    bench.device.put(63, 0)
    bench.device.table.registers[63] = bench.device.table.registers[147]
    done = tailbeat("prepare", "--servo", bench.path, "--fish", "pulley-fish", "--yes")
    assert done.returncode == 1 and "not taken: shutdown" in done.stdout


def test_the_verb_takes_the_family_from_the_fish(sts, tmp_path):
    sts.device.put(19, 0)
    fish = sts_fish(tmp_path)
    done = tailbeat("prepare", "--servo", sts.path, "--fish", fish, "--yes")
    assert done.returncode == 0, done.stderr
    assert sts.device.get(19) == 0b101100 and isinstance(STS_FISH, Fish)


def test_a_servo_with_an_error_is_found_too(sts):
    """Its answer to a ping then has the bytes of the ping."""
    sts.device.put(62, 39)  # V/10: too low
    assert prepare.look(sts.path, STS_FISH).found == prepare.Found(1_000_000, 1, 777)
    connect(sts.path, STS3215, deadline=PATIENT).close()
