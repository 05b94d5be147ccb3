"""The servo's shaft in the plant, with what is broken and what the lab got wrong."""

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.broken import Broken
from tailbeat.emulators.mistakes import Mistakes
from tailbeat.emulators.servo import Shaft
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.link.places import POOL
from tailbeat.pool.mess import in_lab
from tailbeat.pool.plant import Surroundings, at_rest, build_plant, step_plant
from tailbeat.pool.water import Water

Array = NDArray[np.float64]


@dataclass(eq=False)
class PlantShaft(Shaft):
    """The servo's shaft in the plant: setpoint in, angle and velocity out."""

    fish: Fish = field(kw_only=True)
    pool: tuple[float, float] = field(default=POOL, kw_only=True)
    water: Water = field(default_factory=Water, kw_only=True)
    broken: Broken = field(default_factory=Broken, kw_only=True)
    mistakes: Mistakes = field(default_factory=Mistakes, kw_only=True)
    began: float = field(default_factory=time.monotonic, kw_only=True)

    def __post_init__(self) -> None:
        lab = self.mistakes.lab
        water, around = in_lab(lab, self.water, Surroundings(walls=self.pool))
        self.plant = build_plant(self.fish, [water], around=[around], wear=[lab.wear])
        self.state, self.gain, self.owed = (
            at_rest(self.plant),
            float(self.plant.servo["kp"][0]),
            0.0,
        )

    def advance(self, goal: float | None, dt: float) -> None:
        """Step the plant by `dt` [s]; without torque (`goal` None) the servo's gain is 0. Raises
        BadInput if the plant diverges."""
        broken, wrong = self.broken, self.mistakes.lab.errors
        self.plant.servo["kp"][0] = 0.0 if goal is None else self.gain
        share = (-1 if broken.reversed else 1) * broken.slipping
        self.owed += dt
        steps = int(self.owed / self.plant.dt)
        if steps:
            self.owed -= steps * self.plant.dt
            turned = share * broken.stroke * (goal or 0.0) + wrong.horn
            swum = step_plant(self.plant, self.state, np.full((1, steps), turned), steps)
            if swum.lost.any():
                raise BadInput(
                    f"{self.fish.name}: diverges in the virtual pool; look at its warnings with"
                    f" `tailbeat show`."
                )
            # Of a motor without torque the circuit is open; else its back EMF, which a description
            # counts as damping of the shaft, takes from its current.
            lost = float(self.plant.servo["damping"][0]) * float(self.state.v[0, 3])
            self.drawn = share * (float(swum.torque[0, -1]) - lost) if goal is not None else 0.0
        self.angle = (float(self.state.q[0, 3]) - wrong.horn) / share + wrong.encoder
        self.velocity = float(self.state.v[0, 3]) / share

    def put(self, tag: tuple[float, float, float]) -> None:
        """Put the fish where its tag has this pose: x, y [m], yaw [rad]."""
        self.state.q[0, :3] = 0.0, 0.0, tag[2]
        ahead = self.pose[:2]
        self.state.q[0, :2] = tag[0] - ahead[0], tag[1] - ahead[1]

    def snap(self, left: bool = True, right: bool = True) -> None:
        """Cut tendons; with both, motor and tail turn freely of each other."""
        tendon = self.plant.own.tendon
        tendon["left_cut"][0], tendon["right_cut"][0] = left, right

    def hold(self) -> None:
        """Clamp the head where it is."""
        self.state.v[0, :3] = self.state.a[0, :3] = 0.0  # a clamp keeps a velocity, however small
        self.plant.each.held[0] = True

    @property
    def pose(self) -> Array:
        """Pose of the tag: x, y [m], yaw [rad]."""
        return tracked_pose(self.fish, self.state.q[0, :3])
