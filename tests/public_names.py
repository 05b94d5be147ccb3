"""What `make check` (mypy) must know of the public names; `test_api.py` holds the list complete.

Each import fails there if a type checker is not told of the name. Each `nothing` is an error that
is expected: of a name without a type it is none, and then the comment is refused as unused.
"""

# ruff: noqa: B018  (what these expressions give is not used)

import tailbeat as tb
from tailbeat import (
    BadInput,
    Fish,
    FishEnv,
    FishVectorEnv,
    Recording,
    Reward,
    RunConfig,
    Settings,
    Task,
    as_bench,
    as_run,
    compile_twin,
    decide,
    identify_fluid,
    identify_servo,
    identify_tail,
    in_pool,
    in_twin,
    load_fish,
    load_policy,
    new_fish,
    predict,
    reach,
    read_recording,
    recipe_of,
    settings_for,
    simulate,
    train_policy,
    with_values,
    write_recording,
)


def unknown() -> None:
    """Never called."""
    BadInput.nothing  # type: ignore[attr-defined]
    Fish.nothing  # type: ignore[attr-defined]
    FishEnv.nothing  # type: ignore[attr-defined]
    FishVectorEnv.nothing  # type: ignore[attr-defined]
    Recording.nothing  # type: ignore[attr-defined]
    Reward.nothing  # type: ignore[attr-defined]
    RunConfig.nothing  # type: ignore[attr-defined]
    Settings.nothing  # type: ignore[attr-defined]
    Task.nothing  # type: ignore[attr-defined]
    as_bench.nothing  # type: ignore[attr-defined]
    as_run.nothing  # type: ignore[attr-defined]
    compile_twin.nothing  # type: ignore[attr-defined]
    decide.nothing  # type: ignore[attr-defined]
    identify_fluid.nothing  # type: ignore[attr-defined]
    identify_servo.nothing  # type: ignore[attr-defined]
    identify_tail.nothing  # type: ignore[attr-defined]
    in_pool.nothing  # type: ignore[attr-defined]
    in_twin.nothing  # type: ignore[attr-defined]
    load_fish.nothing  # type: ignore[attr-defined]
    load_policy.nothing  # type: ignore[attr-defined]
    new_fish.nothing  # type: ignore[attr-defined]
    predict.nothing  # type: ignore[attr-defined]
    reach.nothing  # type: ignore[attr-defined]
    read_recording.nothing  # type: ignore[attr-defined]
    recipe_of.nothing  # type: ignore[attr-defined]
    settings_for.nothing  # type: ignore[attr-defined]
    simulate.nothing  # type: ignore[attr-defined]
    train_policy.nothing  # type: ignore[attr-defined]
    with_values.nothing  # type: ignore[attr-defined]
    write_recording.nothing  # type: ignore[attr-defined]
    tb.nothing  # type: ignore[attr-defined]
