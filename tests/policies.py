"""Every policy of the repository by name: the shipped one, and the evidence in examples/."""

from pathlib import Path

from tailbeat.control.policy import shipped

EXAMPLES = Path(__file__).parents[1] / "examples"
KEPT = EXAMPLES / "policies"
EARLIER = KEPT / "pulley-fish-pool-earlier.toml"  # the twin in which most of them were trained
MESSY = sorted((EXAMPLES / "policies-messy").glob("*.onnx"))
PACE = sorted((EXAMPLES / "policies-follow").glob("*.onnx"))
ALL = (*shipped().values(), *sorted(KEPT.glob("*.onnx")), *MESSY, *PACE)
POLICIES = {path.stem: path for path in ALL}


def trained_in(name: str) -> str:
    """The twin in which a policy was trained: its file, or the shipped one's name."""
    newer = "-far-" in name or "-full-" in name or name.endswith("-reach")
    return "pulley-fish-pool" if newer else str(EARLIER)
