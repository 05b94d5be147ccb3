"""Every policy of the repository by name: the shipped one, and the evidence in examples/."""

from pathlib import Path

from tailbeat.control.policy import shipped

EXAMPLES = Path(__file__).parents[1] / "examples"
KEPT = EXAMPLES / "policies"
MESSY = sorted((EXAMPLES / "policies-messy").glob("*.onnx"))
POLICIES = {path.stem: path for path in (*shipped().values(), *sorted(KEPT.glob("*.onnx")), *MESSY)}
