"""Swims as a robot writes them."""

from tailbeat.robot import log as logs


def write_logs(swims, folder, **notes):
    """Log files of swims (`identify.offsets.Logged`), with these notes in their heads."""
    paths = []
    for number, swim in enumerate(swims):
        path = folder / f"swim{number}.mcap"
        kept = logs.start(path, notes)
        age = swim.time - swim.pose_time
        columns = (swim.time, *swim.pose.T, age, swim.yaw_rate, swim.angle, swim.speed)
        for t, x, y, yaw, late, rate, angle, speed, sent in zip(
            *columns, swim.command, strict=True
        ):
            kept.put({"time_s": 100 + t, "x_m": x, "y_m": y, "yaw_rad": yaw, "pose_age_s": late,
                      "yaw_rate_rad_s": rate, "motor_angle_rad": angle, "command_rad": sent,
                      "motor_velocity_rad_s": speed, "state": "run"})  # fmt: skip
            while kept.waiting.qsize() > 100:
                pass
        kept.close()
        paths.append(path)
    return paths
