"""Every policy of the repository by name: the shipped one, and the evidence in examples/."""

from pathlib import Path

from tailbeat.control.policy import shipped

KEPT = Path(__file__).parents[1] / "examples" / "policies"
POLICIES = {path.stem: path for path in (*shipped().values(), *sorted(KEPT.glob("*.onnx")))}
