"""Networks that learn their own statistics of a series, trained together with the density estimator."""

import torch
from torch import Tensor, nn


class StridedCNN(nn.Module):
    """Convolutions with stride 4 over time, then a linear readout: (n, channels, time) to (n, outputs).

    The last layer is linear, so no output is stuck at zero; no normalisation over the batch, which would mix atoms.
    Widths are of our choosing; averages over eight stretches of time keep the place of what the filters find.
    """

    def __init__(self, *, channels: int, outputs: int, width: int = 32, stages: int = 3, places: int = 8) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for stage in range(stages):
            incoming = channels if stage == 0 else width
            layers += [nn.Conv1d(incoming, width, kernel_size=7, stride=4 if stage < 2 else 2, padding=3), nn.ELU()]
        self.filters = nn.Sequential(*layers, nn.AdaptiveAvgPool1d(places), nn.Flatten())
        self.readout = nn.Sequential(nn.Linear(width * places, 64), nn.ELU(), nn.Linear(64, outputs))

    def forward(self, y: Tensor) -> Tensor:
        return self.readout(self.filters(y.contiguous().to(torch.float32)))
