"""`multilight insert`: put an object into a capture of many views, and harmonize them all alike."""

from multilight.model.captures.request import Insertion


class Insert(Insertion):
    """Put an object into a capture of many views, and harmonize all of them alike.

    The capture is a nerfstudio folder (transforms.json), a COLMAP folder (images and sparse/0), or a folder of
    pictures, whose poses are then found. Written are composites/, harmonized/, scene.ply (Gaussians), and orbit.mp4.
    """

    def run(self) -> int:
        """Insert, harmonize, write, and return the exit code."""
        self.check()
        from multilight.datagen.commands.output import print_written, progress

        with progress("views", "starting") as report:
            from multilight.model.captures.run import insert_into_files

            made = insert_into_files(self, report)
        print_written(self.out, made)
        return 0
