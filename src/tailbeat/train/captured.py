"""An update as a CUDA graph: its hundreds of small kernels start with one call.

One kernel of an update takes a GPU microseconds, its start from Python ten times as long.
"""

from collections.abc import Callable

import torch

Tensor = torch.Tensor
WARM = 3  # calls before the capture, on a stream of their own, as torch asks


class Captured:
    """A function of tensors whose shapes stay. Its first calls run it as it is; then it is captured
    once, and every call copies its tensors into place and replays the graph. What it reads from
    Python is read at the capture only."""

    def __init__(self, function: Callable[..., Tensor]) -> None:
        self.function, self.calls = function, 0
        self.graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, *tensors: Tensor) -> Tensor:
        """The function's result for these tensors."""
        self.calls += 1
        if self.calls <= WARM:
            return self._apart(tensors)
        if self.graph is None:
            self._capture(tensors)
        assert self.graph is not None
        for place, tensor in zip(self.places, tensors, strict=True):
            place.copy_(tensor)
        self.graph.replay()
        return self.result.clone()

    def _apart(self, tensors: tuple[Tensor, ...]) -> Tensor:
        beside, now = torch.cuda.Stream(), torch.cuda.current_stream()
        beside.wait_stream(now)
        with torch.cuda.stream(beside):
            found = self.function(*tensors)
        now.wait_stream(beside)
        return found

    def _capture(self, tensors: tuple[Tensor, ...]) -> None:
        """Nothing is computed here."""
        self.places = [tensor.clone() for tensor in tensors]
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.result = self.function(*self.places)
