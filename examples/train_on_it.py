"""Train on it: a tiny network learns to give a pasted object the scene's light. Every sample is lit anew."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import nn
from torch.utils.data import DataLoader

import multilight


def main(out: Path, steps: int = 400) -> None:
    """Make three small scenes and train for `steps` batches; the picture is of scenes that it learnt from."""
    data = multilight.make(out / "training", preset="tabletop", seed=30, scenes=3, views=4, width=128, height=128)
    wanted = multilight.SampleSettings(size=64, length=16 * steps, split=None)
    loader = DataLoader(multilight.MultiLightDataset(data.address, wanted), batch_size=16)
    layers = [nn.Conv2d(8, 32, 3, 2, 1), nn.ReLU(), nn.Conv2d(32, 64, 3, 2, 1), nn.ReLU(), nn.Conv2d(64, 64, 3, 2, 1)]
    network = nn.Sequential(*layers, nn.ReLU(), nn.AvgPool2d(8), nn.Flatten(), nn.Linear(64, 3))  # a gain a colour
    optimizer = torch.optim.Adam(network.parameters(), 2e-3)
    for step, batch in enumerate(loader):
        composite, target, mask = batch["composite"], batch["target"], batch["mask"]
        gain = network(torch.cat([composite, batch["background"], batch["depth"], mask], dim=1)).exp()[..., None, None]
        result = composite * (1 - mask + mask * gain)
        loss, before = (((picture - target).abs() * mask).sum() / mask.sum() for picture in (result, composite))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 50 == 0:
            print(f"step {step}: error in the object {loss:.3f}, of the composite {before:.3f}")

    rows = [torch.cat(list(pictures[:6]), dim=2) for pictures in (composite, result, target)]
    shown = torch.cat(rows, dim=1).detach().clamp(0, 1).permute(1, 2, 0).numpy() * 255
    Image.fromarray(shown.astype(np.uint8)).save(out / "train_on_it.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
