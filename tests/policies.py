"""Every policy of the repository by name: the shipped one, and the evidence in examples/."""

from pathlib import Path

from tailbeat.control.policy import shipped

KEPT = Path(__file__).parents[1] / "examples" / "policies"
POLICIES = {path.stem: path for path in (*shipped().values(), *sorted(KEPT.glob("*.onnx")))}
# Trained in the twin before the present one, and kept as evidence.
FORMER = ("pulley-fish-pool-follow-0", "pulley-fish-pool-direct-idealised")
CURRENT = [name for name in POLICIES if name not in FORMER]
