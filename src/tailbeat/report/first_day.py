"""What a lab prints before its first day at the pool: the fish, what its policy should reach, what
it stands, how sure the twin is, and what to check on site. It reads what other verbs measured."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tailbeat.control.measure import Measure, centimetres
from tailbeat.control.policy import Policy, contract_digest
from tailbeat.evaluate import evaluation
from tailbeat.evaluate.advice import ADVICE
from tailbeat.evaluate.margins import Margin, Margins, by_safety, read_margins
from tailbeat.evaluate.rates import ConditionResult
from tailbeat.files import BadInput
from tailbeat.fish import render
from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.show import read_back
from tailbeat.fish.twin import compile_twin
from tailbeat.identify.posterior import Posterior, estimates
from tailbeat.identify.quantities import UNITS
from tailbeat.report import html
from tailbeat.report.html import Block, Section
from tailbeat.report.style import styled
from tailbeat.report.tables import percent
from tailbeat.robot import findings


@dataclass(frozen=True)
class Measured:
    """What is known of a policy before the first day, each None where nobody measured it: its
    success in messy labs, its margins, and the posterior of its twin."""

    messy: tuple[ConditionResult, ...] | None
    margins: Margins | None
    posterior: Posterior | None


def measured(
    policy: Policy, swum: Path | None, margins: Path | None, posterior: Posterior | None
) -> Measured:
    """Read the folders of `tailbeat evaluate` and `tailbeat margins`. Raises BadInput for one of
    another policy, or one without what is needed."""
    own, messy, stood = contract_digest(policy.contract), None, None
    if swum is not None:
        found = evaluation.read(swum)
        _check_own(swum, found.run.policy, own)
        if not found.messy:
            raise BadInput(f"{swum}: no messy labs in it; evaluate with --tasks messy.")
        messy = found.messy
    if margins is not None:
        stood = read_margins(margins)
        _check_own(margins, stood.run.policy, own)
    return Measured(messy, stood, posterior)


def _check_own(folder: Path, theirs: str, ours: str) -> None:
    if theirs != ours:
        raise BadInput(f"{folder}: of another policy ({theirs}, not {ours}); measure this one.")


def write(policy: Policy, name: str, fish: Fish, known: Measured, out: Path) -> Path:
    """Write `report.html` into a folder; returns its path."""
    facts = _facts(policy, name, fish)
    sections = [
        Section("Fish and policy", (html.figure(picture(fish), out, "fish"), html.values(facts))),
        Section("Expected success", _success(known.messy, policy.contract.measure)),
        Section("What it stands", _margins(known.margins)),
        Section("How sure the twin is", _doubt(known.posterior)),
        Section("On site", _checks(name)),
    ]
    return html.write(out, sections, facts, f"{fish.name}: before the first day")


def as_report(policy: Policy, name: str, fish: Fish, known: Measured) -> dict[str, Any]:
    """The page's numbers; None where nobody measured them. `decided` of the twin's numbers are
    decided by the recordings."""
    doubt = known.posterior
    found = None if doubt is None else estimates(doubt)
    return {
        "policy": name,
        "policy_digest": contract_digest(policy.contract),
        "fish": fish.name,
        "length_m": length_of(fish),
        "mass_kg": read_back(fish).own_mass,
        "band_hz": policy.contract.band,
        "messy": known.messy,
        "margins": known.margins,
        "twin": found,
        "decided": found and sum(one.decided for one in found.values()),
        "discrepancy": doubt and doubt.discrepancy,
        "checks": dict(findings.ADVICE),
    }


def _facts(policy: Policy, name: str, fish: Fish) -> dict[str, Any]:
    held, contract = policy.contract.training, policy.contract
    low, high = contract.band
    return {
        "fish": fish.name,
        "length [m]": length_of(fish),
        "mass [kg]": read_back(fish).own_mass,
        "band [Hz]": f"{low:g} to {high:g}",
        "policy": name,
        "trained": ", ".join(f"{key} {held[key]}" for key in ("recipe", "seed") if key in held),
        "corrected for one robot": contract.corrections is not None,
        "yaw rate from": contract.yaw_rate,
    }


@styled
def picture(fish: Fish) -> Figure:
    """The fish at rest."""
    twin = compile_twin(fish)
    images, _ = render.frames(twin, np.zeros((1, twin.model.nq)))
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.imshow(next(images))
    axes.set_axis_off()
    return figure


def _success(rows: tuple[ConditionResult, ...] | None, m: Measure) -> tuple[Block, ...]:
    """Success in the four levels, in the fish's measure, or what measures it."""
    if rows is None:
        return (_missing("tailbeat evaluate POLICY --tasks messy --out FOLDER", "--evaluation"),)
    table = [
        {
            "labs": row.condition.removeprefix("messy: "),
            "targets": row.swims,
            f"within {centimetres(m.arrival)} [%]": percent(row.arrived, row.arrived_interval),
            f"within {centimetres(m.near)} [%]": percent(row.near, row.near_interval),
        }
        for row in rows
    ]
    return (html.table(table),)


def _margins(found: Margins | None) -> tuple[Block, ...]:
    """Margins among everyday nuisances, the thinnest first, and what widens three of them."""
    if found is None:
        return (_missing("tailbeat margins POLICY --out FOLDER", "--margins"),)
    rows = [_margin(row) for row in by_safety(found.margins)]
    advice = [{"thinnest": name, "what widens it": ADVICE[name]} for name in found.thinnest]
    return html.table(advice), html.table(rows)


def _margin(row: Margin) -> Mapping[str, Any]:
    stood = row.most if row.size is None else row.size
    more = "more than " if row.size is None else ""
    return {
        "nuisance": f"{row.nuisance}: {row.what}",
        "unit": row.unit,
        "lab, or everyday": row.lab or row.everyday,
        "stands": f"{more}{stood:.3g}",
        "factor of safety": f"{more}{row.safety:.3g}",
    }


def _doubt(known: Posterior | None) -> tuple[Block, ...]:
    """How many numbers the recordings decide, and how far the twin is from held-out swims."""
    if known is None:
        said = (
            "No posterior of the fish that the policy was trained on: give its file with --twin, or"
            " run `tailbeat identify posterior`."
        )
        return (Block("warning", said),)
    found = estimates(known).values()
    decided = sum(one.decided for one in found)
    rows: dict[str, Any] = {"numbers that the recordings decide": f"{decided} of {len(found)}"}
    if known.discrepancy is not None:
        for name, one in zip(UNITS, known.discrepancy.all, strict=True):
            if one.swims:
                rows[f"{name.replace('_', ' ')}: measured over the twin's"] = (
                    f"{one.factor:.3f} ± {1.96 * one.error:.3f}"
                )
        rows["measured on swims"] = known.discrepancy.swims
    return (html.values(rows),)


def _checks(name: str) -> tuple[Block, ...]:
    """The command that checks everything, and what to do where a check fails."""
    rows = [
        {"check": check, "if it fails": do, "done": ""} for check, do in findings.ADVICE.items()
    ]
    words = shlex.join(["tailbeat", "doctor", "--policy", name])
    ports = "--fish FISH --servo PORT --imu PORT --listen HOST:PORT --station HOST:PORT --key FILE"
    return Block("command", f"{words} {ports}"), html.table(rows)


def _missing(command: str, option: str) -> Block:
    return Block("warning", f"Not measured: run `{command}` and give {option} FOLDER.")
