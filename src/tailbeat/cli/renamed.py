"""Answer an old verb or option with its new name."""

from tailbeat.files import BadInput

VERBS = {
    ("pace",): "latency",
    ("flutter",): "speed-map",
    ("laptop",): "station",
    ("rig",): "emulate",
    ("bench",): "benchmark",
    ("let-go",): "torque-off",
    ("identify", "motor"): "identify servo",
    ("protocol", "motor"): "protocol servo",
    ("record", "motor"): "record servo",
}
OPTIONS = {
    ("--rig", "drive"): "--emulated",
    ("--rig", "doctor"): "--emulated",
    ("--laptop", "drive"): "--station",
    ("--laptop", "doctor"): "--station",
    ("--laptop", "unit"): "--station",
    ("--console", "swim"): "--page",
    ("--console", "drive"): "--page",
    ("--console", "station"): "--page",
    ("--console", "emulate"): "--page",
}


def refuse_old_names(words: list[str]) -> None:
    """Raises BadInput if the command line has an old name of a verb or an option."""
    for count in (1, 2):
        if new := VERBS.get(tuple(words[:count])):
            old = " ".join(words[:count])
            raise BadInput(f"{old} is now {new}: tailbeat {' '.join([new, *words[count:]])}")
    for word in words[1:]:
        old = word.split("=")[0]
        if new := OPTIONS.get((old, words[0])):
            raise BadInput(f"{words[0]}: {old} is now {new}; see tailbeat {words[0]} --help.")
