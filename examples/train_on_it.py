"""Train on it: the ready-made model learns on from three scenes of your own. Every sample is lit anew, on the fly."""

from pathlib import Path

import torch
from PIL import Image
from torch.utils.data import DataLoader

import multilight
from multilight.model.networks.checkpoint import load_network


def main(out: Path, steps: int = 150) -> None:
    """Make three small scenes and train for `steps` batches; the picture is of the last, whose light was new to it."""
    data = multilight.make(out / "training", preset="tabletop", seed=30, scenes=3, views=4, width=128, height=128)
    wanted = multilight.SampleSettings(size=96, length=8 * steps, split=None)
    loader = DataLoader(multilight.MultiLightDataset(data.address, wanted), batch_size=8)
    network = load_network(Path("slim")).train()
    optimizer = torch.optim.Adam(network.parameters(), 3e-4)
    errors = []
    for step, batch in enumerate(loader, start=1):
        composite, target = batch["composite"], batch["target"]
        result = network(composite, batch["background"], batch["depth"], batch["mask"])
        loss = (result - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        errors.append((loss.item(), (composite - target).square().mean().item()))
        if step % 25 == 0 or step == steps:
            ours, before = torch.tensor(errors[-25:]).sum(dim=0)
            print(f"step {step}: {ours / before:.2f} of the composites' squared error")
    rows = [torch.cat(list(pictures[:6]), dim=2) for pictures in (composite, result, target)]
    shown = torch.cat(rows, dim=1).detach().clamp(0, 1).permute(1, 2, 0) * 255
    Image.fromarray(shown.byte().numpy()).save(out / "train_on_it.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
