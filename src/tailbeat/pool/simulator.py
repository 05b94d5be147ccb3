"""The plant as a `env.world` body: the same sensors, targets and policy, in unsteady water.

The world sees of it what a camera, an encoder and an IMU see; water, fins and lags stay here.
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

Array = NDArray[np.float64]
STRAIGHT = (Surroundings(),)


class PoolSimulator:
    """n fish, each in a water of its own. `draw` and pushes are the twin's; here they do nothing:
    what varies is given by `water` and `around` (see `plant.build_plant`)."""

    def __init__(
        self,
        fish: Fish,
        water: Sequence[Water],
        around: Sequence[Surroundings] = STRAIGHT,
        servo: Servo | None = None,
    ) -> None:
        self.plant = build_plant(fish, water, servo, around)
        self.steps = round(PERIOD / self.plant.dt)
        if len(self.plant.water) != len(water):
            raise BadInput(f"{len(water)} waters for {len(self.plant.water)} surroundings.")
        self.state = at_rest(self.plant)
        self.qpos, self.qvel, self.motor = self.state.q, self.state.v, 3
        self.energy = np.zeros(len(water))  # J that the actuator put in, since the last rest
        self.only: tuple[NDArray[np.int64], Plant] | None = None

    def rest(self, chosen: NDArray[np.int64]) -> None:
        """Straight and still, fins attached, nothing on its way to the servo."""
        for values in (self.state.q, self.state.v, self.state.a, self.state.history):
            values[chosen] = 0.0
        self.state.wakes[chosen] = UNDISTURBED
        self.energy[chosen] = 0.0

    def draw(self, fish: int, ranges: Randomisation, rng: np.random.Generator) -> None:
        """The plant is what it is."""

    def ready(self, chosen: NDArray[np.int64]) -> None:
        """Nothing to derive."""

    def keep(self, going: NDArray[np.bool_]) -> None:
        """Step only these fish from now on; the others stay as they are, and cost nothing."""
        chosen = np.flatnonzero(going)
        self.only = (chosen, self.plant.part(chosen))

    def advance(self, setpoint: Array, push: Array) -> NDArray[np.bool_]:
        """One control period; fish whose numbers left the finite are lost and put to rest."""
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
        """Count the energy, put lost fish to rest; which were lost, of all."""
        power = swum.torque[:, 1:] * swum.v[:, 1:, self.motor]
        self.energy[chosen] += np.maximum(power, 0.0).sum(axis=1) * self.plant.dt
        lost = np.zeros(len(self.energy), dtype=bool)
        lost[chosen] = swum.lost
        if lost.any():
            self.rest(np.flatnonzero(lost))
        return lost
