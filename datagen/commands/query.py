"""The command `query`: which scenes of a dataset are like this?"""

from dataclasses import dataclass

import tyro


@dataclass
class Query:
    """List the scenes for which an SQL expression over the index holds; exit code 1 where there is none.

    Examples, each as one word of the shell, in double quotes:

    kind = 'room' and emissive

    split = 'train' and contrast_ev > 2 and hardest_deg < 1

    array_contains(categories, 'vase') and not mirror

    array_contains(light_kinds, 'sun') and array_length(lights) > 3

    array_to_string(surroundings, ' ') like '%sofa%'

    light_shares[1] > 0.5

    The same expressions choose scenes for the exports (--where) and for training.
    """

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    where: tyro.conf.Positional[str | None] = None
    """The expression (default: all scenes)."""
    columns: tuple[str, ...] = (
        "index",
        "kind",
        "split",
        "emissive",
        "mirror",
        "contrast_ev",
        "hardest_deg",
        "insertable",
    )
    """Columns to show; `all` shows every one."""
    describe: bool = False
    """Only this: say what the columns are."""
    json: bool = False
    """Print JSON, a list of objects, instead of a table."""

    def run(self) -> int:
        """Print and return the exit code."""
        from multilight.datagen.commands.look_up import describe, print_rows, query

        if self.describe:
            return describe(as_json=self.json)
        return print_rows(query(self.dir, self.where, self.columns), as_json=self.json)
