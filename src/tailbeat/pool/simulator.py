"""The plant as a simulator of `env.world`: the same sensors, targets and policy, in unsteady water.

The world gets only what camera, encoder and IMU measure.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.env.randomize import Randomisation
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo
from tailbeat.pool.plant import (
    Plant,
    Surroundings,
    Swum,
    at_rest,
    build_plant,
    step_plant,
)
from tailbeat.pool.section import UNDISTURBED
from tailbeat.pool.water import Water
from tailbeat.pool.wear import Wear

Array = NDArray[np.float64]
STRAIGHT = (Surroundings(),)
AS_DESCRIBED = (Wear(),)


class PoolSimulator:
    """n fish, each in its own water. `draw` and pushes of the twin have no effect here: `water`,
    `around` and `wear` give what varies (see `plant.build_plant`)."""

    def __init__(
        self,
        fish: Fish,
        water: Sequence[Water],
        around: Sequence[Surroundings] = STRAIGHT,
        servo: Servo | None = None,
        wear: Sequence[Wear] = AS_DESCRIBED,
    ) -> None:
        self.plant = build_plant(fish, water, servo, around, wear=wear)
        self.steps = round(PERIOD / self.plant.dt)
        if len(self.plant.water) != len(water):
            raise BadInput(
                f"{len(water)} waters for {len(self.plant.water)} surroundings; give equal numbers."
            )
        self.state = at_rest(self.plant)
        self.qpos, self.qvel, self.motor = self.state.q, self.state.v, 3
        self.energy = np.zeros(len(water))  # J, put in by the actuator since the last rest
        self.only: tuple[NDArray[np.int64], Plant] | None = None

    def rest(self, chosen: NDArray[np.int64]) -> None:
        """Reset fish: straight and at rest, flow attached, no delayed commands."""
        for values in (self.state.q, self.state.v, self.state.a, self.state.history):
            values[chosen] = 0.0
        self.state.wakes[chosen] = UNDISTURBED
        self.energy[chosen] = 0.0

    def draw(self, fish: int, ranges: Randomisation, rng: np.random.Generator) -> None:
        """No effect: the plant is not randomised."""

    def ready(self, chosen: NDArray[np.int64]) -> None:
        """No effect: nothing is derived from drawn values."""

    def keep(self, going: NDArray[np.bool_]) -> None:
        """Step only these fish from now on; the others do not change and take no time."""
        chosen = np.flatnonzero(going)
        self.only = (chosen, self.plant.part(chosen))

    def advance(self, setpoint: Array, push: Array) -> NDArray[np.bool_]:
        """Step one control period. Fish with numbers that are not finite are lost and put to
        rest."""
        commands = np.repeat(np.asarray(setpoint, float)[:, None], self.steps, axis=1)
        if self.only is None:
            return self._settle(
                np.arange(len(commands)), step_plant(self.plant, self.state, commands)
            )
        chosen, plant = self.only
        own = self.state.part(chosen)
        swum = step_plant(plant, own, commands[chosen])
        self.state.put(chosen, own)
        return self._settle(chosen, swum)

    def _settle(self, chosen: NDArray[np.int64], swum: Swum) -> NDArray[np.bool_]:
        """Count the energy and put lost fish to rest; returns which of all fish were lost."""
        power = swum.torque[:, 1:] * swum.v[:, 1:, self.motor]
        self.energy[chosen] += np.maximum(power, 0.0).sum(axis=1) * self.plant.dt
        lost = np.zeros(len(self.energy), dtype=bool)
        lost[chosen] = swum.lost
        if lost.any():
            self.rest(np.flatnonzero(lost))
        return lost
