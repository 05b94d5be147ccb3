"""What a lab says of its own accuracy: the table `[lab]` of a fish's file.

`tailbeat margins` sets these figures against what a policy stands. Verbs with `--mess FILE` swim in
a lab that is wrong by so much.
"""

from pydantic import Field

from tailbeat.fish import units as u
from tailbeat.fish.bodies import Model


class Lab(Model):
    """The largest error that the lab expects, to either side. What is left out counts as
    everyday."""

    horn: u.Angle | None = Field(default=None, gt=0)
    """Angle of the horn off its zero."""
    bend: u.Angle | None = Field(default=None, gt=0)
    """Bend of the loose tail at rest, over all hinges."""
    slack: u.Angle | None = Field(default=None, gt=0)
    """Turn of the shaft that pulls no tendon."""
    sticking: u.Angle | None = Field(default=None, gt=0)
    """Bend in which the loose tail stays."""
    stiffness: u.Fraction | None = Field(default=None, gt=0)
    """Tail stiffer or softer than identified."""
    damping: u.Fraction | None = Field(default=None, gt=0)
    """Damping of the tail."""
    friction: u.Torque | None = Field(default=None, gt=0)
    """Friction at the shaft beyond what was identified."""
    mass: u.Fraction | None = Field(default=None, gt=0)
    """Mass of the bodies."""
    centre: u.Length | None = Field(default=None, gt=0)
    """Centre of the head's mass, ahead or astern."""
    fin: u.Fraction | None = Field(default=None, gt=0)
    """Height of the fin."""
    added_mass: u.Fraction | None = Field(default=None, gt=0)
    """Water that the body carries."""
    servo_gain: u.Fraction | None = Field(default=None, gt=0)
    """Gain of the servo."""
    servo_torque: u.Fraction | None = Field(default=None, gt=0)
    """Largest torque of the servo."""
    servo_delay: u.Time | None = Field(default=None, gt=0)
    """Delay of the servo beyond what was identified."""
    fading: u.Fraction | None = Field(default=None, gt=0)
    """Loss of the servo's torque in a session, by heat and supply."""
    current: u.Speed | None = Field(default=None, gt=0)
    """Steady current."""
    stirring: u.Speed | None = Field(default=None, gt=0)
    """Eddies, rms."""
    tether_pull: u.Force | None = Field(default=None, gt=0)
    """Pull of a tether."""
    tag_askew: u.Angle | None = Field(default=None, gt=0)
    """Angle at which the tag is glued."""
    tag_ahead: u.Length | None = Field(default=None, gt=0)
    """Place of the tag, ahead or astern."""
    tag_sideways: u.Length | None = Field(default=None, gt=0)
    """Place of the tag, sideways."""
    scale: u.Fraction | None = Field(default=None, gt=0)
    """Scale of the camera's positions."""
    rotation: u.Angle | None = Field(default=None, gt=0)
    """Rotation of the camera's frame."""
    lens: u.Length | None = Field(default=None, gt=0)
    """Error of the lens 2 m from the pool's middle."""
    latency: u.Time | None = Field(default=None, gt=0)
    """Latency of the camera beyond the contract's."""
    hidden: u.Time | None = Field(default=None, gt=0)
    """Length of bursts of lost frames."""
    tether_drag: u.TetherDrag | None = Field(default=None, gt=0)
    """Drag of a tether."""
    gyro_bias: u.AngularRate | None = Field(default=None, gt=0)
    """Bias of the yaw rate."""
    gyro_drift: u.AngularRate | None = Field(default=None, gt=0)
    """Drift of the yaw rate in a swim."""
    encoder: u.Angle | None = Field(default=None, gt=0)
    """Error of the shaft's reading alone."""
