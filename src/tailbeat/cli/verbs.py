"""The verbs, in the order of use: module, help sentence, example."""

from tailbeat.cli.robot_verbs import ROBOT
from tailbeat.cli.verb import Verb as Verb

PANELS = {
    "Describe a fish": (
        Verb(
            "new-fish",
            "describe:new_fish",
            "Write a fish to start from, from a few measured numbers.",
            "my-fish.toml --length 280mm --mass 350g --hinges 4 --servo xl330",
        ),
        Verb(
            "show",
            "describe:show",
            "Print what a fish compiles to and render a picture.",
            "my-fish.toml --picture fish.png",
        ),
    ),
    "Measure it": (
        Verb(
            "protocol",
            "measure:protocol",
            "Write the commands that the test bench plays.",
            "tail --fish my-fish.toml --out commands",
        ),
        Verb(
            "play",
            "play:play",
            "Play commands on the fish's servo and record shaft and, of swims, poses.",
            "commands/fluid-*.csv --fish my-fish.toml --servo /dev/ttyUSB0 --out data",
        ),
        Verb(
            "record",
            "measure:record",
            "Play a protocol in the virtual pool and record it as a lab would.",
            "fluid --fish pulley-fish --out pool-data",
        ),
        Verb(
            "import fishsim",
            "measure:import_fishsim",
            "Convert marker tracks in pixels to a recording in metres.",
            "markers.csv --out swim.csv",
        ),
        Verb(
            "import xl330",
            "measure:import_xl330",
            "Convert a servo's pendulum log to a recording.",
            "pendulum.json --out pendulum.csv",
        ),
        Verb(
            "import table",
            "measure:import_table",
            "Convert any table to a recording in SI units.",
            "log.json --map time=t,angle=position --unit deg --out log.csv",
        ),
    ),
    "Identify it": (
        Verb(
            "identify tail",
            "identify:identify_tail",
            "Fit the tail's stiffness and damping to driven sweeps with shaft torque.",
            "sweep.csv --fish my-fish.toml --static pull.csv --out tail.toml",
        ),
        Verb(
            "identify servo",
            "identify:identify_servo",
            "Fit the servo to recorded commands and encoder angles.",
            "--fish tail.toml --fit chirp.csv steps.csv --validate mixed.csv --out servo.toml",
        ),
        Verb(
            "identify fluid",
            "identify:identify_fluid",
            "Fit the fluid coefficients to recorded swims.",
            "--fish servo.toml --fit swim1.csv swim2.csv --validate swim3.csv --out mine.toml",
        ),
        Verb(
            "identify logs",
            "offsets:identify_logs",
            "Fit servo, tail and water of a fish to logged swims of one robot.",
            "swim1.mcap swim2.mcap --fish mine.toml --out this-robot.toml",
        ),
        Verb(
            "identify posterior",
            "identify:identify_posterior",
            "Write the posterior of a fish that is identified already.",
            "--fish mine.toml --fit bench/fluid-*.csv --check bench/check-*.csv",
        ),
        Verb(
            "identify next",
            "identify:identify_next",
            "Rank the recordings that could be made next by what a prediction would gain.",
            "--fish mine.toml --goal turning",
        ),
        Verb(
            "identify all",
            "identify:identify_all",
            "Fit tail, servo and fluid to the recordings of one folder.",
            "--fish pulley-fish --from pool-data --out mine.toml",
        ),
        Verb(
            "predict",
            "predict:predict",
            "Predict recorded swims with the twin and compare with what was measured.",
            "swim.csv --fish mine.toml",
        ),
        Verb(
            "coverage",
            "predict:coverage",
            "Check whether an identification's recordings cover a policy's swims.",
            "swim.csv --against swim1.csv swim2.csv --fish mine.toml",
        ),
    ),
    "Learn": (
        Verb(
            "train",
            "training:train",
            "Train a policy through the stages of a recipe.",
            "--fish mine.toml --actions generator --out runs/mine",
        ),
        Verb(
            "sweep",
            "sweep:sweep",
            "Train many policies from one file, try and evaluate each, and compare them.",
            "sweep.toml --out sweeps/mine",
        ),
        Verb("policy show", "learn:show", "Print a policy's contract.", "runs/mine/policy.onnx"),
        Verb(
            "policy diff",
            "learn:diff",
            "List the fields in which two policies' contracts differ.",
            "runs/mine/policy.onnx pulley-fish-pool-reach",
        ),
        Verb(
            "policy try",
            "learn:try_",
            "Swim a policy to seeded targets in its twin or in the virtual pool.",
            "runs/mine/policy.onnx --fish mine.toml --targets 200",
        ),
        Verb(
            "policy rule",
            "rule:rule",
            "Write the policy of a hand-made steering rule, to compare learned ones with.",
            "--fish mine.toml --out rule.onnx",
        ),
        Verb(
            "policy expect",
            "learn:expect",
            "Write into a policy's file what its swims look like to the robot's own sensors.",
            "runs/mine/policy.onnx",
        ),
    ),
    "Evaluate": (
        Verb(
            "evaluate",
            "evaluate:evaluate",
            "Evaluate a policy in the virtual pool: targets, disturbances, tracks, messy labs.",
            "runs/mine/policy.onnx --fish pulley-fish --twin mine.toml --out runs/evaluation",
        ),
        Verb(
            "compare",
            "evaluate:compare",
            "Compare policies in their twins and in the pool, with parts of its physics off.",
            "runs/a/policy.onnx runs/b/policy.onnx --twin mine.toml --out runs/comparison",
        ),
        Verb(
            "margins",
            "margins:margins",
            "Measure how much of each thing that labs get wrong a policy stands.",
            "runs/mine/policy.onnx --out runs/margins",
        ),
        Verb(
            "refinement",
            "refinement:refinement",
            "Measure in messy labs what refining a policy from its logs gains.",
            "runs/mine/policy.onnx --mess rough --labs 4",
        ),
        Verb(
            "zoo",
            "zoo:zoo",
            "Take eight fish of all sizes from a wrong first guess to targets in the pool.",
            "--out zoo --only 0",
        ),
        Verb(
            "speed-map",
            "evaluate:speed_map",
            "Compare the speeds of twin and virtual pool over frequency and stroke.",
            "--fish mine.toml --out speeds.png",
        ),
        Verb(
            "limits",
            "limits:limits",
            "Measure how slowly and tightly a fish can be steered, and how it stops.",
            "--fish pulley-fish --twin mine.toml --out limits",
        ),
        Verb(
            "first-day",
            "first_day:first_day",
            "Write a page to print before the first day at the pool.",
            "runs/mine/policy.onnx --evaluation runs/messy --margins runs/margins --out first-day",
        ),
        Verb(
            "report",
            "evaluate:report",
            "Write a page of a folder's numbers and figures, with the paper's for comparison.",
            "runs/evaluation",
        ),
    ),
    **ROBOT,
}
HEADS = {
    "import": "Convert files of other formats to recordings.",
    "identify": "Fit a fish's parameters to recordings.",
    "policy": "Inspect, compare and try policies.",
}
