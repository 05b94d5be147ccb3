"""The page of a recording: columns and metadata that some verb reads or writes."""

from reference.markdown import code, page, table
from tailbeat.recording import SUFFIXES

COLUMNS = {
    "time_s": ("all", "Time of the sample [s]. It rises and need not be uniform."),
    "condition": ("tail", "Text: which part of a sweep a row belongs to."),
    "command_rad": ("servo", "Setpoint of the servo [rad]."),
    "angle_rad": ("tail, servo", "Shaft angle on the test bench [rad]."),
    "torque_nm": ("tail", "Torque on the shaft [N m]."),
    "enabled_ratio": ("servo", "1 with torque on, 0 with torque off."),
    "velocity_rad_s": ("servo", "Shaft speed that the servo reports [rad/s]."),
    "pwm_ratio": ("servo", "Duty of the servo's motor, -1 to 1."),
    "voltage_v": ("servo", "Supply at the servo [V]."),
    "motor_angle_rad": ("fluid", "Shaft angle of the swimming fish [rad]; a crank's goes on."),
    "x_m": ("fluid", "Place of the tracked point in the pool, x [m]."),
    "y_m": ("fluid", "Place of the tracked point in the pool, y [m]."),
    "yaw_rad": ("fluid", "Heading, counter-clockwise from x [rad]."),
    "yaw_rate_rad_s": ("fluid", "Yaw rate of the IMU, counter-clockwise positive [rad/s]."),
    "marker0_x_m": ("fluid", "Place of marker 0, x [m]; empty where it was not seen."),
    "marker0_y_m": ("fluid", "Place of marker 0, y [m]; empty where it was not seen."),
}
METADATA = {
    "gain": ("servo", "P gain of the servo, as its register holds it."),
    "load": ("servo", "What hung on the shaft: `tail`, `pendulum` or `nothing`."),
    "load_mass_kg": ("servo", "Mass of the pendulum [kg]."),
    "load_arm_m": ("servo", "Distance of the pendulum's mass from the shaft [m]."),
    "launch": ("fluid", "Surge, sway [m/s] and yaw rate [rad/s] at the first sample."),
    "begin": ("fluid", "Where in the pool a swim begins: `end` or `middle`."),
    "source": ("all", "Where the recording comes from."),
    "purpose": ("all", "What a protocol's command is for."),
    "rate_hz": ("all", "Sampling rate of a protocol's command [Hz]."),
    "play": ("tail, servo", "How to play a protocol's command."),
    "water": ("all", "Fingerprint of the virtual pool's water."),
    "frame_rate_hz": ("fluid", "Frames per second of the video [Hz]."),
    "metres_per_pixel": ("fluid", "Scale of the video [m]."),
    "frames_dropped_per_marker": ("fluid", "Frames in which a marker slipped."),
    "motor": ("servo", "Model of the servo."),
    "trajectory": ("servo", "Name of the command in an imported log."),
    "supply_v": ("servo", "Supply of the servo [V]."),
}
HEAD = """A recording is a table, CSV or Parquet. A CSV holds metadata as comment lines
`# key: value` at its top. The end of a column's name is its unit. A cell may be empty in marker
columns alone. Positive motor angle bends the tail tip to the left."""


def recording_page() -> str:
    """Columns, metadata, and the ends that a column's name may have."""
    columns = table(["column", "recording", "meaning"], _rows(COLUMNS))
    metadata = table(["key", "recording", "meaning"], _rows(METADATA))
    ends = f"A column's name ends in one of {', '.join(map(code, SUFFIXES))}."
    return page("Recording", HEAD, "## Columns", ends, columns, "## Metadata", metadata)


def _rows(names: dict[str, tuple[str, str]]) -> list[list[str]]:
    return [[code(name), where, text] for name, (where, text) in names.items()]
