"""Swim a fish open-loop in its twin: commands in, a swim out."""

import numpy as np

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, Swim, replay_command, swim
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.recording import Recording, require

SAMPLE = 0.02  # s between the samples of a swim


def simulate(fish: Fish, command: Recording) -> Swim:
    """Swim from rest in still water, with a sample every 20 ms.

    `command` has the column `command_rad`, which the servo follows. A crank has no servo; it turns
    by `motor_angle_rad`. Between the rows the angle changes linearly. Raises BadInput if the column
    is missing or time does not rise.
    """
    crank = fish.motor.kind == "crank"
    (given,) = require(command, ["motor_angle_rad" if crank else "command_rad"])
    twin = compile_twin(fish, Options(replayed=crank))
    step = twin.model.opt.timestep
    since = command.time - command.time[0]
    angle = np.interp(np.arange(0, since[-1] + step / 2, step), since, given)
    every = max(round(SAMPLE / step), 1)
    if not crank:
        return swim([twin], [Start.at_rest()], [angle], every)[0]
    speed = float(np.diff(angle[:2])[0] / step)
    start = Start(np.zeros(3), np.zeros(3), float(angle[0]), speed)
    return swim([twin], [start], [replay_command(twin, angle)], every)[0]
