"""What is it good for? The same training with one thing changed at a time, judged on the same pictures.

Each ablation is a function that names its variants and, for each, the values that differ from the base: the slim
network of the 2D stage, or the 3D stage on given 2D weights. All variants of a seed see samples drawn alike, train as
long, and are averaged alike; none is chosen by how well it does.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import nn

from multilight.datagen.config.loading import Values, joined, validated
from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_folder
from multilight.datagen.report import Report, silent
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.store import write_text
from multilight.model.ablations.settings import AblationSettings
from multilight.model.configs.stage2d import NETWORKS, TrainingConfig
from multilight.model.configs.stage3d import SLIM3D, SceneTrainingConfig
from multilight.model.device import chosen_device
from multilight.model.evaluation.cases import LazyGroup, dataset_groups, with_subset
from multilight.model.evaluation.method3d import SceneMethod
from multilight.model.evaluation.run import Evaluation, Method, evaluate, on_case
from multilight.model.evaluation.settings import CaseSettings
from multilight.model.inference.harmonize import network_harmonizer
from multilight.model.networks.checkpoint import checkpoint_progress, load_network, load_network3d
from multilight.model.networks.compositing3d import Compositing3D
from multilight.model.training.stage2d import train
from multilight.model.training.stage3d import train_scenes
from multilight.model.training.trainer import FINISHED
from multilight.scenes.files.limits import read_json
from multilight.scenes.names import slug

STEPS = {"head": 400, "inputs": 400, "lighting": 1200, "scenes": 400, "emissive": 400, "order": 300}
"""Steps of each training, unless told otherwise; whether lighting repeats itself shows later than all else."""
LAYERS_COST = 2.7
"""Most that a view's layers cost in renders of one of its conditions, with Mitsuba and denoised (a tabletop with seven
insertable objects; a studio with one: 1.6)."""
FEWEST = 10
"""Scenes to train on that lightings are compared with, so that a fifth of them are two."""
MANY = 1000
"""Scenes to train on, of which ever fewer are tried in wider steps."""
COMPOSITE = "composite as it is"
STAGE_2D = "2D stage alone"
AVERAGED = "2D stage, averaged over views, no network"
CARRIED = "2D stage, carried by one pixel each, no network"
GLOW = {"scene glows": "emissive", "scene does not glow": "NOT emissive"}
"""Subsets that the emissive ablation is judged on: their names, and their expressions over the index."""


@dataclass(frozen=True)
class Run:
    """One finished training: of what, how it went, and where the weights are.

    `validation` [dB] is its last one, under stored lighting: PSNR of the object and its effect, by method.
    """

    variant: str
    seed: int
    weights: Path
    parameters: int
    steps: int
    seconds: float
    validation: dict[str, float]

    @property
    def method(self) -> str:
        """Return its name among the evaluation's methods."""
        return f"{self.variant} #{self.seed}"


def variants(settings: AblationSettings, seed: int) -> dict[str, Values]:
    """Return what is compared: each variant's name and the values that differ from the base's."""
    dataset = settings.dataset
    match settings.name:
        case "head":
            return {
                "light": {"network": {"body": "pyramid", "head": "light"}},
                "light, not told the true lights": {
                    "network": {"body": "pyramid", "head": "light"},
                    "loss": {"lights": 0.0},
                },
                "gain": {"network": {"body": "pyramid", "head": "gain"}},
                "gain, attention": {"network": {"body": "attention", "head": "gain"}},
                "residual": {"network": {"body": "pyramid", "head": "residual"}},
                "direct": {"network": {"body": "pyramid", "head": "direct"}},
            }
        case "inputs":
            return {
                "all inputs": {},
                "without background": {"network": {"blind": ["background"]}},
                "without depth": {"network": {"blind": ["depth"]}},
                "without either": {"network": {"blind": ["background", "depth"]}},
            }
        case "lighting":
            count = open_dataset(dataset).record.config.conditions
            return stored_lighting(chosen_scenes(dataset, "split = 'train'"), count, seed)
        case "scenes":
            return fewer_scenes(chosen_scenes(dataset, "split = 'train'"), seed)
        case "emissive":
            glowing, plain = (chosen_scenes(dataset, f"split = 'train' AND {where}") for where in GLOW.values())
            return glowing_scenes(glowing, plain, seed)
        case "order":
            return map_orders()


def stored_lighting(scenes: Sequence[int], count: int, seed: int) -> dict[str, Values]:
    """Return lighting drawn on the fly, and `count` stored conditions: of all scenes, and of as many as cost the same.

    The latter has what the core-seconds of all scenes' layers would pay for if every condition were rendered by itself.
    Both are also trained for a fifth of that cost, where scenes are scarcer. `seed` draws the scenes. Raises
    `UserError` where there are too few of them for that.
    """
    if len(scenes) < FEWEST:
        raise UserError(
            f"{len(scenes)} scenes to train on: comparing lightings at equal cost needs {FEWEST}; make more scenes"
        )
    order = np.random.default_rng(seed).permutation(scenes).tolist()
    fixed: Values = {"data": {"lighting": "stored"}}
    fifth = len(order) // 5
    all_anew, fifth_anew = (max(1, round(kept * LAYERS_COST / count)) for kept in (len(order), fifth))
    anew = f"{count} conditions, each rendered anew"
    return {
        "drawn for every sample": {},
        f"{count} stored conditions a scene ({count * (count - 1)} pairs)": fixed,
        f"{anew}: {all_anew} scenes for the same core-seconds": joined(only(order[:all_anew]), fixed),
        f"drawn for every sample, {fifth} scenes": only(order[:fifth]),
        f"{anew}: {fifth_anew} scenes for the core-seconds of {fifth}": joined(only(order[:fifth_anew]), fixed),
    }


def map_orders() -> dict[str, Values]:
    """Return networks on Gaussians in several orders, each coloured by one pixel, and one on colours of all views.

    As published: what views disagree on is left to the network, which has to know what lies near what.
    """
    networks: dict[str, Values] = {
        "Hilbert curve": {},
        "Z-order curve": {"order": "morton"},
        "arbitrary order": {"order": "arbitrary"},
        "no map: transformer on 3D clusters": {"layout": "points"},
        "Hilbert curve, with places and normals": {"layout": "map+points"},
        "Hilbert curve, colours averaged over views": {"carry": "average"},
    }
    return {name: {"network": {"carry": "pixel"} | values} for name, values in networks.items()}


def fewer_scenes(scenes: Sequence[int], seed: int) -> dict[str, Values]:
    """Return trainings on 1/8, 1/4, 1/2 and all of the scenes; `seed` draws them, and each holds the smaller ones.

    Of a thousand scenes and more, on 1/45, 1/11, 1/3 and all: 45, 186, 681 and 2042 of the preset `volume`.
    """
    order = np.random.default_rng(seed).permutation(scenes).tolist()
    parts = (8, 4, 2, 1) if len(order) < MANY else (45, 11, 3, 1)
    counts = [max(1, round(len(order) / part)) for part in parts]
    return {f"{count} of {len(order)} scenes": only(order[:count]) for count in counts}


def glowing_scenes(glowing: Sequence[int], plain: Sequence[int], seed: int) -> dict[str, Values]:
    """Return a training on the `plain` scenes, and one on as many of which half have something that glows.

    Raises `UserError` where there are too few of either.
    """
    count = min(len(plain) // 2, len(glowing))
    if count == 0:
        raise UserError(
            f"{len(glowing)} scenes to train on have something that glows, {len(plain)} have not: the comparison needs "
            "one and two at least; make more scenes"
        )
    rng = np.random.default_rng(seed)
    mixed = [*rng.permutation(glowing)[:count].tolist(), *rng.permutation(plain)[: len(plain) - count].tolist()]
    return {f"{len(plain)} scenes, none glows": only(plain), f"{len(plain)} scenes, {count} glow": only(mixed)}


def only(scenes: Sequence[int]) -> Values:
    """Return the values that train on these scenes alone."""
    return {"data": {"where": f"index IN ({', '.join(map(str, sorted(scenes)))})"}}


def chosen_scenes(dataset: str, where: str) -> tuple[int, ...]:
    """Return the numbers of the scenes for which an SQL expression over the index holds."""
    return open_dataset(dataset, where=where).indices


def base_values(settings: AblationSettings) -> Values:
    """Return the training that all variants share, but for `out` and the seeds."""
    held_out = [split for split in settings.splits if chosen_scenes(settings.dataset, f"split = '{split}'")]
    if not held_out:
        raise UserError(f"{settings.dataset} has no scene of {', '.join(settings.splits)}; choose others with --splits")
    steps = settings.steps or (None if settings.minutes else STEPS[settings.name])
    values: Values = {
        "steps": steps, "minutes": settings.minutes, "warmup": 50, "save_every": 200, "log_every": 50,
        "device": settings.device, "data": {"train": settings.dataset, "validation_split": held_out[0]},
    }  # fmt: skip
    if settings.name != "order":
        values["data"] |= {"workers": settings.workers, "validation_samples": 32}
        stage = {"size": settings.size, "batch": settings.batch}
        return values | {"network": NETWORKS["slim"].model_dump(mode="json"), "stages": [stage]}
    if settings.weights_2d is None:
        raise UserError("the order of Gaussians is compared on top of the 2D stage: give its weights with --weights-2d")
    values["data"] |= {"workers": 0, "validation_samples": 8}
    values |= {"network": SLIM3D.model_dump(mode="json"), "stages": [{"size": settings.size, "batch": 1}]}
    side = 1 << (settings.size.bit_length() - 1)  # about as many Gaussians as a picture has pixels
    return values | {"weights_2d": str(settings.weights_2d), "views": 3, "side": side, "learning_rate": 5e-4}


def ablate(settings: AblationSettings, base: Values, report: Report = silent) -> tuple[list[Run], Evaluation]:
    """Train what is not trained yet, and evaluate every variant of every seed on the same pictures.

    `base` is what `base_values` returns; `report` is told of trainings, and the comparison as one more part. Goes on
    where an earlier call was stopped. Raises `UserError` where `settings.out` holds another comparison.
    """
    groups = _groups(settings)
    _claim(settings, base)
    plans = [(seed, *each) for seed in range(settings.seeds) for each in variants(settings, seed).items()]
    runs: list[Run] = []
    said = ""

    def part(done: float, total: float, note: str = "") -> None:
        report(len(runs) + done / (total or 1.0), len(plans) + 1, said)

    for seed, name, values in plans:
        said = f"training {name}, seed {seed}"
        print(said, flush=True)
        runs.append(_trained(settings, name, seed, joined(base, values), part))
    said = "comparing"
    return runs, evaluate(groups, _methods(settings, base, runs), report=part)


def _trained(settings: AblationSettings, name: str, seed: int, values: Values, report: Report) -> Run:
    folder = settings.out / "runs" / f"{slug(name, '-')}-{seed}"
    values = joined(values, {"out": folder, "seed": seed, "data": {"seed": seed}})
    network: nn.Module
    if settings.name == "order":
        found = train_scenes(validated(values, SceneTrainingConfig, settings.name), report=report)
        network = load_network3d(folder / FINISHED)
    else:
        found = train(validated(values, TrainingConfig, settings.name), report=report)
        network = load_network(folder / FINISHED)
    progress = checkpoint_progress(folder / "checkpoints")
    parameters = sum(p.numel() for p in network.parameters())
    return Run(name, seed, folder / FINISHED, parameters, progress.step, progress.seconds, found)


def _methods(settings: AblationSettings, base: Values, runs: Sequence[Run]) -> dict[str, Method]:
    methods: dict[str, Method] = {COMPOSITE: lambda case: case.composite}
    if settings.weights_2d is None or settings.name != "order":
        return methods | {run.method: on_case(network_harmonizer(run.weights, settings.device)) for run in runs}
    methods[STAGE_2D] = on_case(network_harmonizer(settings.weights_2d, settings.device))
    device = chosen_device(settings.device)
    stage2d = load_network(settings.weights_2d).to(device)
    for name, carry in ((AVERAGED, "average"), (CARRIED, "pixel")):
        untrained = Compositing3D(SLIM3D.model_copy(update={"carry": carry})).eval()
        methods[name] = SceneMethod(stage2d, untrained.to(device), base["side"])
    for run in runs:
        methods[run.method] = SceneMethod(stage2d, load_network3d(run.weights).to(device), base["side"])
    return methods


def _groups(settings: AblationSettings) -> list[LazyGroup]:
    chosen = CaseSettings(settings.splits, settings.groups, size=settings.size)
    if settings.name != "emissive":
        return dataset_groups(settings.dataset, chosen)
    found = {subset: dataset_groups(settings.dataset, chosen, where) for subset, where in GLOW.items()}
    return [with_subset(group, subset) for subset, groups in found.items() for group in groups]


def _claim(settings: AblationSettings, base: Values) -> None:
    """Write down what is compared in `settings.out`; raises `UserError` where that differs from an earlier call."""
    path = settings.out / "ablation.json"
    asked = json.loads(json.dumps({"ablation": settings.name, **base}))
    if not path.is_file():
        check_folder(settings.out)
        write_text(path, json.dumps(asked, indent=1))
        return
    try:
        stored = read_json(path)
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read: {error}; choose another --out") from None
    for key in sorted(asked.keys() | stored.keys()):
        if asked.get(key) != stored.get(key):
            raise UserError(
                f"{settings.out} holds a comparison with {key} = {stored.get(key)!r}, now it is {asked.get(key)!r}; "
                "choose another --out"
            )
