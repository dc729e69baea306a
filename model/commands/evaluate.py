"""`multilight evaluate`: how good models are, beside classical methods, on scenes never seen."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from multilight.datagen.errors import UserError
from multilight.model.evaluation.settings import CaseSettings

if TYPE_CHECKING:
    from multilight.datagen.report import Report
    from multilight.model.evaluation.cases import LazyGroup
    from multilight.model.evaluation.run import Evaluation


@dataclass
class Evaluate:
    """Compare models with the truth, and with classical harmonization: tables and pictures (HTML, Markdown, JSON)."""

    dir: tyro.conf.Positional[str | None] = None
    """Dataset: a folder or an address."""
    out: Path = field(kw_only=True)
    """Folder to write index.html, table.md and evaluation.json to."""
    weights: tuple[Path, ...] = (Path("slim"),)
    """Weights of the models to compare: files, or ready-made ones by name."""
    weights_3d: Path | None = None
    """Weights of the 3D stage, to be compared on top of the last of `weights`."""
    refine_iterations: tuple[int, ...] = ()
    """Compare the 3D stage also on Gaussians refined on the views for so many iterations, each number a row of its
    own. The paper has 250, 1000 and 10000."""
    cases: CaseSettings = field(default_factory=CaseSettings)
    owl: Path | None = None
    """Instead: folder of Objects With Lighting."""
    foscom: Path | None = None
    """Instead: folder of FOSCom (pictures only: it has no truth)."""
    depth_model: Path | None = None
    """ONNX depth model for sets without depth."""
    lpips: Path | None = None
    """Weights for LPIPS: torchvision's vgg16 or alexnet (.pth)."""
    device: str = "auto"
    """Device of the models: auto, cpu, or cuda."""

    def run(self) -> int:
        """Evaluate, write the pages, print the main table, and return the exit code."""
        self._check()
        from multilight.datagen.commands.output import print_written, progress

        with progress("objects", "starting") as report:
            found = self._compared(report)
        if not found.frames:
            raise UserError(f"--size {self.cases.size}: no picture shows enough of its object; choose a larger one")
        from multilight.model.evaluation.page import markdown, tables_of, write_evaluation

        about = self._about(len(found.frames_of(None)))
        write_evaluation(found, about, self.out)
        print(markdown(tables_of(found), about))
        print_written(self.out, f"index.html, table.md, evaluation.json; {len(found.frames)} frames in all")
        return 0

    def _compared(self, report: "Report") -> "Evaluation":
        """Harmonize all pictures with all methods, and compare."""
        from multilight.model.evaluation.lpips import Lpips
        from multilight.model.evaluation.method3d import scene_method, without_network
        from multilight.model.evaluation.run import evaluate, methods_of
        from multilight.model.inference.harmonize import network_harmonizer

        groups = self._groups()
        models = {name: network_harmonizer(path, self.device) for name, path in named(self.weights).items()}
        methods = methods_of(models)
        last = list(models)[-1]
        if self._several():
            methods |= without_network(last, self.weights[-1], self.device)
        if self.weights_3d is not None:
            for steps in (0, *self.refine_iterations):
                name = f"{last} + 3D, {steps} refined" if steps else f"{last} + 3D"
                methods[name] = scene_method(self.weights[-1], self.weights_3d, self.device, refine_iterations=steps)
        lpips = Lpips.load(self.lpips) if self.lpips else None
        report(0, len(groups), "comparing")
        return evaluate(groups, methods, lpips=lpips, report=report)

    def _check(self) -> None:
        """Raise `UserError` for whatever can be known to be wrong before the work."""
        from multilight.datagen.files.outputs import check_folder
        from multilight.model.configs.checks import LEAST_SIDE, MOST_SIDE, check_file, check_range, check_splits
        from multilight.model.configs.ready_made import check_device, weights_config
        from multilight.model.configs.stage2d import NetworkConfig
        from multilight.model.configs.stage3d import SceneNetworkConfig

        if self.refine_iterations and (self.weights_3d is None or min(self.refine_iterations) < 1):
            raise UserError(
                f"--refine-iterations {' '.join(map(str, self.refine_iterations))}: "
                "needs --weights-3d, and numbers from 1 up; 0 is always compared"
            )
        if sum(place is not None for place in (self.dir, self.owl, self.foscom)) != 1:
            raise UserError("say what to evaluate on: a dataset (multilight evaluate DIR), --owl DIR or --foscom DIR")
        check_range("--size", self.cases.size, LEAST_SIDE, MOST_SIDE)
        check_range("--groups", self.cases.groups, 1, 10**6)
        check_range("--views", self.cases.views, 1, 1000)
        check_device(self.device)
        for path in self.weights:
            weights_config(path, NetworkConfig)
        if not self.weights or len(named(self.weights)) < len(self.weights):
            raise UserError(f"--weights {' '.join(map(str, self.weights))}: give one or more different files")
        if self.weights_3d is not None:
            weights_config(self.weights_3d, SceneNetworkConfig)
        check_file("--depth-model", self.depth_model)
        check_file("--lpips", self.lpips)
        if self.dir is not None:
            check_splits(self.dir, self.cases.splits)
        check_folder(self.out)

    def _groups(self) -> "list[LazyGroup]":
        from multilight.model.evaluation.cases import dataset_groups
        from multilight.model.evaluation.foscom import foscom_groups
        from multilight.model.evaluation.objects_with_lighting import owl_groups
        from multilight.model.inference.depth import DepthModel

        model = DepthModel.load(self.depth_model) if self.depth_model else None
        if self.owl is not None:
            return owl_groups(self.owl, model)[: self.cases.groups]
        if self.foscom is not None:
            return foscom_groups(self.foscom, model)[: self.cases.groups]
        assert self.dir is not None
        return dataset_groups(self.dir, self.cases)

    def _several(self) -> bool:
        """Say whether all groups have several views."""
        from multilight.datagen.storage.open_dataset import open_dataset

        return self.dir is not None and self.cases.views > 1 and min(open_dataset(self.dir).table["views"]) > 1

    def _about(self, frames: int) -> dict[str, str]:
        """Say what was evaluated on what."""
        import torch

        from multilight.datagen.storage.store import file_sha256
        from multilight.model.configs.ready_made import weights_file

        place = str(self.dir or self.owl or self.foscom)
        facts = {"data": place, "frames": str(frames), "torch": torch.__version__, "device": self.device}
        if self.dir is not None:
            size = f"{self.cases.size} x {self.cases.size}"
            facts |= {"splits": ", ".join(self.cases.splits), "seed": str(self.cases.seed), "size": size}
            facts["lighting"] = self.cases.lighting
        return facts | {
            f"weights {name}": file_sha256(weights_file(path))[:12] for name, path in named(self.weights).items()
        }


def named(weights: Sequence[Path]) -> dict[str, Path]:
    """Name models after their files, with the folder where two files are alike."""
    stems = [path.stem for path in weights]
    alone = [stems.count(stem) == 1 for stem in stems]
    return {
        path.stem if own else f"{path.parent.name}/{path.stem}": path for path, own in zip(weights, alone, strict=True)
    }
