"""The verbs of the robot, its checks and its emulators, in the order of use."""

from tailbeat.cli.verb import Verb

ROBOT = {
    "Swim": (
        Verb(
            "swim",
            "swim:swim",
            "Swim to targets in the virtual pool, in real time.",
            "--headless --targets 8",
        ),
        Verb(
            "drive",
            "drive:drive",
            "Run the fish's control loop at 50 Hz: arm, swim, turn torque off.",
            "pulley-fish-pool-reach --emulated --log swim.mcap --seconds 30",
        ),
        Verb(
            "station",
            "station:station",
            "Run the poolside station: find the fish, send its pose, show the operator page.",
            "--robot 192.168.4.2:5151 --listen 192.168.4.1:5150 --key fish.key",
        ),
        Verb(
            "tags",
            "camera:tags",
            "Write the sheets to print: fish tag, target tag and calibration board, at true size.",
            "--out tags.pdf",
        ),
        Verb(
            "calibrate",
            "camera:calibrate",
            "Find the camera's lens parameters and its pose above the pool.",
            "--views views --survey survey.csv --picture pool.png --out camera.json",
        ),
        Verb(
            "track",
            "camera:track",
            "Print the poses of fish and target from a camera, live.",
            "--camera /dev/video0 --calibration camera.json",
        ),
    ),
    "Check": (
        Verb(
            "prepare",
            "prepare:prepare",
            "Set a servo up for a fish: find it, compare its registers, write those that differ.",
            "--servo /dev/ttyUSB0 --fish my-fish.toml",
        ),
        Verb(
            "doctor",
            "check:doctor",
            "List what prevents the fish from swimming, and what to do about it.",
            "--servo /dev/ttyUSB0 --imu /dev/ttyAMA0",
        ),
        Verb(
            "faults",
            "check:faults",
            "Inject faults into emulated devices and measure the time to a safe state.",
            "--only 'voltage sags' --table faults.md",
        ),
        Verb(
            "latency",
            "check:latency",
            "Measure the timing of the control loop on this machine.",
            "--minutes 10",
        ),
        Verb(
            "torque-off",
            "check:torque_off",
            "Turn the servo's torque off.",
            "--servo /dev/ttyUSB0",
        ),
        Verb(
            "unit",
            "check:unit",
            "Write a systemd unit that runs `tailbeat drive`, disarmed until the operator arms it.",
            "policy.onnx --out fish.service --servo /dev/ttyUSB0 --imu /dev/ttyAMA0"
            " --listen 192.168.4.2:5151 --station 192.168.4.1:5150 --key fish.key"
            " --logs /var/log/fish",
        ),
        Verb("key", "check:key", "Write the key that station and fish share.", "fish.key"),
        Verb(
            "export",
            "check:export",
            "Convert a drive's log to a recording that identification reads.",
            "swim.mcap --out swim.csv",
        ),
        Verb(
            "offsets",
            "offsets:offsets",
            "Tell from swims alone what is wrong on a robot: tag, shaft, gyro, current.",
            "swim1.mcap swim2.mcap swim3.mcap",
        ),
        Verb(
            "refine",
            "refine:refine",
            "Correct a policy by what its robot's swims show to be constant and wrong.",
            "runs/mine/policy.onnx --log swim1.mcap swim2.mcap swim3.mcap --out refined",
        ),
        Verb(
            "film",
            "check:film",
            "Render a film of a run in three dimensions from its log.",
            "runs/swim.mcap --out swim.mp4 --view follow --seconds 20",
        ),
    ),
    "Develop": (
        Verb(
            "emulate",
            "develop:emulate",
            "Emulate servo, IMU and camera of a fish in real time.",
            "--fish pulley-fish --key fish.key --robot 127.0.0.1:5151",
        ),
        Verb(
            "camera",
            "develop:camera",
            "Emulate a camera above the pool: frames at a socket, or pictures to calibrate with.",
            "--socket camera.sock",
        ),
        Verb(
            "benchmark",
            "develop:benchmark",
            "Measure speed and accuracy on this machine.",
            "--no-env",
        ),
    ),
}
