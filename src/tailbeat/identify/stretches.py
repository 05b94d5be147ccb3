"""Split a recording into parts that were recorded in one go; check how close its samples are."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tailbeat.files import BadInput
from tailbeat.recording import Recording, changes, rows


def stretches(recording: Recording) -> list[Recording]:
    """Split a recording where time starts again or a setting changes. Settings become the parts'
    metadata. Of several parts, each is named by its first texts."""
    settings = {name: column for name, column in recording.labels.items() if name != "condition"}
    new = (np.diff(recording.time) <= 0) | changes(settings, recording.time.size)
    edges = [0, *(np.flatnonzero(new) + 1), recording.time.size]
    parts = [rows(recording, slice(*pair)) for pair in pairwise(edges)]
    return [_with_settings(part, len(parts) > 1) for part in parts]


def _with_settings(part: Recording, several: bool) -> Recording:
    """The part with its settings as metadata instead of columns, named by its texts."""
    first = {name: str(column[0]) for name, column in part.labels.items()}
    told = [text if name == "condition" else f"{name} {text}" for name, text in first.items()]
    kept = {name: column for name, column in part.labels.items() if name == "condition"}
    meta = {**part.meta, **{name: text for name, text in first.items() if name != "condition"}}
    name = ", ".join([part.name, *told]) if several else part.name
    return replace(part, name=name, labels=kept, meta=meta)


def check_close(recording: Recording, most: float) -> None:
    """Raises BadInput for samples that are usually more than `most` [s] apart."""
    apart = float(np.median(np.diff(recording.time)))
    if apart > most:
        raise BadInput(
            f"{recording.name}: column time_s: samples are {apart:.3g} s apart; allowed is"
            f" {most:g} s. If the times are milliseconds, convert them to seconds."
        )
