"""The simulator of a `World`: the twin's batch. The pool's plant has the same five methods.

A simulator has n fish. `qpos` and `qvel` are live (n, …) arrays: they begin with x, y, yaw of the
head, and have the motor at index `motor`.
"""

from typing import Protocol

import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.env import hardship, randomize
from tailbeat.env.hardship import Hardship
from tailbeat.env.randomize import Randomisation
from tailbeat.fish import surge
from tailbeat.fish.description import Fish
from tailbeat.fish.edge import KUTTA
from tailbeat.fish.rollout import quiet_engine
from tailbeat.fish.twin import compile_twin
from tailbeat.fish.water import correct, water
from tailbeat.processes import threads as default_threads

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Simulator(Protocol):
    """Interface of a simulator: n fish in some water."""

    qpos: Array
    qvel: Array
    motor: int

    def rest(self, chosen: NDArray[np.int64]) -> None:
        """Put some fish at the origin, straight and still."""

    def draw(self, fish: int, ranges: Randomisation, rng: np.random.Generator) -> None:
        """Draw the physics of one fish's next episode."""

    def ready(self, chosen: NDArray[np.int64]) -> None:
        """Compute what follows from the drawn physics."""

    def keep(self, going: Flags) -> None:
        """Step only these fish from now on; the others do not change and take no time."""

    def advance(self, setpoint: Array, push: Array) -> Flags:
        """Step one control period with setpoints (n,) [rad] and pushes (n, 2) [N] on the head.
        Returns which fish diverged (n,)."""


class TwinSimulator:
    """The twin's batch: model fields per fish, all cores, interpreter lock released while it
    steps."""

    def __init__(
        self, fish: Fish, count: int, threads: int = 0, draws: Array | None = None
    ) -> None:
        twin = compile_twin(fish)
        self.substeps = round(PERIOD / twin.model.opt.timestep)
        self.count, self.motor = count, twin.motor
        together = threads or default_threads()
        self.batch = batch.Batch(twin.model, count, nthread=together, persistent=True)
        self.physics = randomize.expand(twin, self.batch, draws)
        self.qpos, self.qvel, self.ctrl, self.force = (
            self.batch.bind(name) for name in ("qpos", "qvel", "ctrl", "xfrc_applied")
        )
        self.head = int(twin.model.body("head").id)
        self.water = water([twin.model] * count, self.batch, self.physics.fields["opt.wind"])
        self.warned = np.zeros(count)
        self.only: Flags | None = None

    def rest(self, chosen: NDArray[np.int64]) -> None:
        """Put fish at rest and remove their pushes."""
        self.batch.reset(chosen, stage=randomize.NO_FORWARD)
        self.force[chosen] = 0.0

    def draw(self, fish: int, ranges: Randomisation, rng: np.random.Generator) -> None:
        """Draw from the nominal twin, not from the last draw."""
        randomize.randomize(self.physics, ranges, fish, rng)

    def harden(self, fish: int, hard: Hardship, rng: np.random.Generator) -> Array:
        """Draw hardships after the physics; returns the steady pull (2,) [N]."""
        return hardship.harden(self.physics, hard, fish, rng)

    def ready(self, chosen: NDArray[np.int64]) -> None:
        """Recompute what the engine derives from masses, and the drawn lift coefficients."""
        randomize.refresh(self.physics, chosen)
        if self.water is not None and (lift := self.water.lift) is not None:
            lift.nominal[chosen] = self.physics.fields["geom_fluid"][chosen][
                :, lift.where.geom, KUTTA
            ]
        if self.water is not None and self.water.relief is not None:
            surge.begin(self.water.relief, chosen)

    def keep(self, going: Flags) -> None:
        """Step only these fish from now on; the others do not change and take no time."""
        self.only = going.copy()

    def advance(self, setpoint: Array, push: Array) -> Flags:
        """Step one control period. If a fish diverges, the engine warns and resets it, and it
        counts as lost."""
        self.ctrl[:, 0] = setpoint
        block = self.substeps if self.water is None else min(self.water.block, self.substeps)
        with quiet_engine():
            for first in range(0, self.substeps, block):
                self._push(first, push)
                self.batch.step(self.only, nstep=block)
        return self._lost()

    def _push(self, step: int, push: Array) -> None:
        """Set the force for the coming steps, the first of which is number `step`."""
        relief = None if self.water is None else correct(self.water, step)
        if relief is not None:
            self.force[:, self.head, 2] = relief[:, 2]
            push = push + relief[:, :2]
        self.force[:, self.head, :2] = push

    def _lost(self) -> Flags:
        """Which fish the engine has warned about since the last call."""
        warning = self.batch.warning
        if int(warning.sum()) == self.warned.sum():
            return np.zeros(self.count, dtype=bool)
        total = warning.reshape(self.count, -1).sum(axis=1)
        lost, self.warned = total > self.warned, total
        return np.asarray(lost)
