"""The light mixer of a dataset's scenes as plain files, for any web server."""

from pathlib import Path

from multilight.datagen.errors import UserError
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import making
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.store import scene_folder
from multilight.datagen.view.content import PREVIEW, ViewFiles, dataset_json, preview, scene_json, view_folder
from multilight.datagen.view.server import PAGE, SITE
from multilight.scenes.files.atomic import write_whole

SQUEEZED = 6
"""Level of zlib; 9 is not smaller."""


def export_web(source: DatasetSource, out: Path, report: Report) -> int:
    """Write the page, and `data/` with every scene, and return how many scenes are there; what is there is kept."""
    with making(out, "web", source, {}) as copy:
        made = []
        for done, record in enumerate(source.scenes()):
            folder = f"data/{scene_folder(record.index)}"
            with source.passing_over(record.index):
                if not copy.keeps(folder, record.index):
                    with copy.filling_part(folder, record.index) as work:
                        (work / "scene.json").write_bytes(scene_json(record))
                        (work / PREVIEW).write_bytes(preview(source, record.index))
                        for number, view in enumerate(source.views(record)):
                            files = ViewFiles(record, view)
                            (work / view_folder(number)).mkdir(parents=True)
                            for name in files.names():
                                (work / view_folder(number) / name).write_bytes(files.file(name, SQUEEZED))
                made.append(record.index)
            report(done + 1, len(source.indices))
        if not made:
            raise UserError(f"{source.address}: no scene can be read; nothing to export")
        contents = {name: (SITE / name).read_bytes() for name in PAGE}
        contents["data/dataset.json"] = dataset_json(source, made, source.address.rpartition("/")[2])
        for name, content in contents.items():
            if not (out / name).is_file() or (out / name).read_bytes() != content:
                with write_whole(out / name) as work:
                    work.write_bytes(content)
        copy.finish(*contents)
    return len(made)
