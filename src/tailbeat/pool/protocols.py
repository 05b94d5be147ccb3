"""Bench and pool experiments, played in the plant and recorded as in a lab.

Commands are those of `identify.protocol`, which a lab plays too, or given ones. The recordings have
a lab's columns, and the water's fingerprint in their metadata.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat.env import errors
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo, ends_of
from tailbeat.fish.show import shaft_stiffness
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.launch import KEY as LAUNCH
from tailbeat.identify.launch import launch_of
from tailbeat.identify.manoeuvres import BEGIN, manoeuvres
from tailbeat.identify.protocol import (
    fluid_runs,
    limits,
    servo_commands,
    tail_static,
    tail_sweep,
)
from tailbeat.identify.shaft import mean_held
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.link.places import LENGTH, POOL, WIDTH
from tailbeat.pool.mess import AS_DESCRIBED, Lab, in_lab, on_the_bench
from tailbeat.pool.plant import (
    Surroundings,
    Swum,
    at_rest,
    build_plant,
    step_plant,
)
from tailbeat.pool.recorder import (
    Sensors,
    camera,
    clock,
    encoder,
    frames,
    torque_cell,
    torque_cell_for,
)
from tailbeat.pool.water import Water, fingerprint
from tailbeat.recording import Recording, require

Array = NDArray[np.float64]
SENSORS, WATER = Sensors(), Water()
DT = 0.002  # s
HALVED = 4  # times that the step is halved for a swim that diverges
SERVO_DT = 0.00025  # s; the mean command of a longer step reaches the force limit too early
AIR = 1.2e-3  # density of air over that of water
MARGIN = 0.35  # m: a recording ends when the fish is this close to a wall
BEGIN_AT, BACKWARD = 0.8, 0.6  # m from the pool's end: start of a swim; more if launched backward
# The test bench's drive for the tail: stiff, and on the motor's side of the torque sensor.
DRIVE = Servo(kp=300.0, kv=3.0, armature=1e-9, damping=0.0, force_limit=50.0, delay=0.0)


def record_tail(
    fish: Fish,
    seed: int = 0,
    sensors: Sensors | None = None,
    water: Water = WATER,
    commands: Sequence[Recording] = (),
    lab: Lab = AS_DESCRIBED,
) -> Iterator[Recording]:
    """Record sweep and slow pull in air: `angle_rad` and `torque_nm` of the shaft. Without
    `sensors` the torque cell suits the fish's tail."""
    limit = limits(fish)
    sensors = sensors or torque_cell_for(limit.angle * shaft_stiffness(fish), SENSORS)
    played = commands or (tail_sweep(fish, limit), tail_static(limit))
    for number, command in enumerate(_checked(fish, played)):
        rng = np.random.default_rng([seed, number])
        smooth = _smooth(command, 0.001)
        own = replace(lab, wear=on_the_bench(lab.wear))
        swum = _play(fish, smooth, _air(water), Surroundings(held=True), DRIVE, 0.001, lab=own)
        time = clock(float(swum.time[-1]), sensors.bench_rate, sensors.jitter, rng)
        labels = command.labels.get("condition", np.full(command.time.size, command.name))
        label = labels[_in_force(command, time)]
        columns = {
            "angle_rad": encoder(_read(swum, time, lab)),
            # the torque of a step is that at its middle
            "torque_nm": torque_cell(
                np.interp(time, swum.time[1:] - swum.time[1] / 2, swum.torque[0, 1:]), sensors, rng
            ),
        }
        yield Recording(command.name, time, columns, _meta(water, lab), {"condition": label})


def record_servo(
    fish: Fish,
    seed: int = 0,
    sensors: Sensors = SENSORS,
    water: Water = WATER,
    commands: Sequence[Recording] = (),
    lab: Lab = AS_DESCRIBED,
) -> Iterator[Recording]:
    """Record the servo with its tail in air: `command_rad` as sent, `angle_rad` as read, at the
    same times."""
    played = commands or tuple(servo_commands(fish, limits(fish)).values())
    for number, command in enumerate(_checked(fish, played)):
        rng = np.random.default_rng([seed, 100 + number])
        time = clock(float(command.time[-1]), sensors.loop_rate, sensors.jitter, rng)
        sent = np.interp(time, command.time, command.columns["command_rad"])
        passes = Recording(command.name, time, {"command_rad": sent})
        swum = _play(fish, passes, _air(water), Surroundings(held=True), None, SERVO_DT, lab=lab)
        columns = {"command_rad": sent, "angle_rad": encoder(_read(swum, time, lab))}
        yield Recording(command.name, time, columns, {**_meta(water, lab), "load": "tail"})


def record_fluid(
    fish: Fish,
    seed: int = 0,
    sensors: Sensors = SENSORS,
    water: Water = WATER,
    commands: Sequence[Recording] = (),
    lab: Lab = AS_DESCRIBED,
) -> Iterator[Recording]:
    """Record free swims along the pool, from rest or launched: encoder and tag at the frames'
    times.

    Cut where the fish comes near a wall. The encoder is read at the loop's rate and interpolated to
    the frames, as a recorder that joins two logs does.
    """
    played = _checked(fish, commands or _swims(fish))
    launches = [launch_of(command, fish) for command in played]
    for number, (command, launch) in enumerate(zip(played, launches, strict=True)):
        rng = np.random.default_rng([seed, 200 + number])
        side = rng.uniform(-0.2, 0.2, 2)
        begin = _begin(fish, command, 0.0 if launch is None else launch[0])
        start = np.array([[begin, side[0], side[1] / 2]])
        around = Surroundings(walls=POOL)
        swum = _play(fish, command, water, around, None, DT, start, launch, lab)
        pose = tracked_pose(fish, swum.q[0, :, :3])
        seconds = _until_wall(swum.time, pose)
        seen = _lit(frames(seconds, sensors, rng), lab, rng)
        loop = clock(seconds, sensors.loop_rate, sensors.jitter, rng)
        angle = np.interp(seen, loop, encoder(_read(swum, loop, lab)))
        exposed = seen + sensors.stamp_noise * rng.normal(size=seen.size) - lab.errors.late
        late = np.clip(exposed, 0, seconds)
        true = np.stack([_at(swum, c, late) for c in pose.T], axis=1)
        poses = camera(errors.filmed(errors.rows([lab.errors]), true), sensors, rng)
        columns = dict(zip(("x_m", "y_m", "yaw_rad"), poses.T, strict=True))
        columns = {"motor_angle_rad": angle, **columns}
        stated = {} if launch is None else {LAUNCH: command.meta[LAUNCH]}
        yield Recording(command.name, seen, columns, {**_meta(water, lab), **stated})


def record_check(
    fish: Fish,
    seed: int = 0,
    sensors: Sensors = SENSORS,
    water: Water = WATER,
    commands: Sequence[Recording] = (),
    lab: Lab = AS_DESCRIBED,
) -> Iterator[Recording]:
    """Record free swims unlike the protocol's (`identify.check_swims`), as `record_fluid` does;
    another seed plays other commands."""
    played = commands or tuple(check_swims(fish, limits(fish), seed=seed).values())
    return record_fluid(fish, seed, sensors, water, played, lab)


def _swims(fish: Fish) -> list[Recording]:
    """The protocol's commands, for a fish whose motor has a range."""
    limit = limits(fish)
    return [*fluid_runs(fish, limit).values(), *manoeuvres(fish, limit).values()]


def _begin(fish: Fish, command: Recording, surge: float) -> float:
    """Start x [m] of a swim: the pool's end, or the middle if the command says so. A fish launched
    backward starts farther from the end, and so does one whose fin would be near the wall."""
    if command.meta.get(BEGIN) == "middle":
        return 0.0
    rear, _ = ends_of(fish)
    return -LENGTH / 2 + max(BEGIN_AT, MARGIN - rear) + (BACKWARD if surge < 0 else 0.0)


def _checked(fish: Fish, commands: Sequence[Recording]) -> Sequence[Recording]:
    """Check that commands stay inside the motor's range, before anything is played. Raises
    BadInput."""
    low, high = fish.motor.range or (-np.inf, np.inf)
    for command in commands:
        (angle,) = require(command, ["command_rad"])
        row = int(np.argmax(np.maximum(angle - high, low - angle)))
        if not low <= angle[row] <= high:
            raise BadInput(
                f"{command.name}: column command_rad, row {row + 1}: {angle[row]:.3f} is outside"
                f" motor.range {low:.3f} to {high:.3f} of {fish.name}; use one of"
                f" `tailbeat protocol`."
            )
    return commands


def _air(water: Water) -> Water:
    return replace(water, density=water.density * AIR)


def _play(
    fish: Fish,
    command: Recording,
    water: Water,
    around: Surroundings,
    servo: Servo | None,
    dt: float,
    start: Array | None = None,
    launch: Array | None = None,
    lab: Lab = AS_DESCRIBED,
) -> Swum:
    """Play a command recording to its end, in a lab; each setpoint is held until the next.

    `launch` (3,) is the head's velocity at the start, in the fish frame. A small fish may need a
    step shorter than `dt`. Raises BadInput for a swim that diverges at every step.
    """
    flow, place = in_lab(lab, water, around)
    for step in dt / 2.0 ** np.arange(HALVED):
        plant = build_plant(fish, [flow], servo, [place], float(step), [lab.wear])
        state = at_rest(plant, start)
        if launch is not None:
            cos, sin = np.cos(state.q[0, 2]), np.sin(state.q[0, 2])
            surge, sway, turn = launch
            state.v[0, :3] = cos * surge - sin * sway, sin * surge + cos * sway, turn
        edges = np.asarray(step * np.arange(int(command.time[-1] / step) + 3), dtype=np.float64)
        held = mean_held(command.time, command.columns["command_rad"], edges)
        swum = step_plant(plant, state, held[None] + lab.errors.horn)
        if not swum.lost.any():
            return swum
    raise BadInput(
        f"{command.name}: {fish.name} diverges in the virtual pool, also at a step of"
        f" {1e3 * step:g} ms; check the masses and sizes of its parts with `tailbeat show`."
    )


def _smooth(command: Recording, dt: float) -> Recording:
    """Interpolate a command as a motion controller does: no steps every 20 ms."""
    time = np.arange(command.time[0], command.time[-1], dt)
    curve = CubicSpline(command.time, command.columns["command_rad"])(time)
    return Recording(command.name, np.asarray(time), {"command_rad": np.asarray(curve)})


def _in_force(command: Recording, time: Array) -> NDArray[np.int64]:
    """Which sample of a command is in force at each time."""
    return np.searchsorted(command.time, time + 1e-9, side="right") - 1


def _at(swum: Swum, values: Array, time: Array) -> Array:
    """Interpolate the plant's values between its steps."""
    return np.asarray(CubicSpline(swum.time, values)(np.minimum(time, swum.time[-1])))


def _read(swum: Swum, time: Array, lab: Lab) -> Array:
    """Angles of the shaft as the servo counts them."""
    return _at(swum, swum.q[0, :, 3], time) - lab.errors.horn + lab.errors.encoder


def _lit(seen: Array, lab: Lab, rng: np.random.Generator) -> Array:
    """Times of frames without those of a lab's dark bursts; always the first."""
    if not lab.errors.dark:
        return seen
    dark = errors.dark_steps(lab.errors.dark, int(seen[-1] / errors.PERIOD) + 1, rng)
    lit = ~dark[(seen / errors.PERIOD).astype(int)]
    lit[0] = True
    return seen[lit]


def _until_wall(time: Array, pose: Array) -> float:
    """Time [s] until the tag comes within the margin of a wall, or the whole time."""
    near = np.maximum(np.abs(pose[:, 0]) - LENGTH / 2, np.abs(pose[:, 1]) - WIDTH / 2) > -MARGIN
    return float(time[np.argmax(near)] if near.any() else time[-1])


def _meta(water: Water, lab: Lab) -> dict[str, str]:
    where = "tailbeat virtual pool" if lab == AS_DESCRIBED else "tailbeat virtual pool, messy"
    return {"source": where, "water": fingerprint([water])}
