"""What a tracking run leaves behind: poses as BOP results files; its pictures are in `evaluation.pictures`."""

from pathlib import Path

from hierax.nodes.sources.files import writing
from hierax.nodes.tracking.datasets.bop import ResultsFile, check_no_results, scene_number
from hierax.nodes.tracking.math.geometry import invert
from hierax.nodes.tracking.schema import ScoredPose
from hierax.runtime import Probe, Step

POSES_FILE = "poses.csv"
TRUTH_FILE = "truth.csv"


class BopResults(Probe):
    """The arm's corrected poses as BOP results files, written through at every epoch.

    They go to `file` and, where the run has an output folder, to ``poses.csv`` in it. A frame that is told again
    replaces what was written of it.

    Args: file: path, relative to the folder that the run was started in; None for none. scene: the scene's folder,
        whose name is the scene's number; None gives number 0.
    """

    prompt = True

    def __init__(self, file: str | None = None, scene: str | None = None) -> None:
        self._files = [] if file is None else [Path(file)]
        self._scene_id = scene_number(scene)
        self._results: list[ResultsFile] = []

    def open(self, output: Path | None) -> None:
        """Begin the files. Raises DataError: one cannot be written, or there are poses in it already, and it may not be
        written over, or something else."""
        self._begin(output, again=False)

    def open_again(self, output: Path | None) -> None:
        """Go on behind what is in the files. Raises DataError: one cannot be written, or is no results file."""
        self._begin(output, again=True)

    def record(self, step: Step) -> None:
        """One frame's poses, as the arm has them after its observation."""
        belief = step.sensed
        for results in self._results if belief["frame"] is not None else ():
            results.write(belief["frame"], belief["objects"])

    def close(self) -> None:
        """End the files."""
        for results in self._results:
            results.close()
        self._results = []

    def _begin(self, output: Path | None, again: bool) -> None:
        paths = [*self._files, *([] if output is None else [output / POSES_FILE])]
        different = {path.resolve(): path for path in paths}
        for path in () if again else different.values():
            check_no_results(path, self.overwrite)
        self._results = []
        for path in different.values():
            self._results.append(ResultsFile(path, self._scene_id, again))


class Truth(Probe):
    """The simulated world's true poses, seen by its camera, as a BOP results file ``truth.csv`` in the output folder.
    Of a scene folder's world nothing is written: it knows no truth. A frame that is told again replaces what was
    written of it."""

    prompt = True

    _results: ResultsFile | None = None
    _file: Path | None = None

    def open(self, output: Path | None) -> None:
        """Remember the file, which begins with the first true pose; what another run left there is removed. Raises
        DataError: there is one, and it may not be written over, or something else."""
        if output is not None:
            self._file = output / TRUTH_FILE
            check_no_results(self._file, self.overwrite)
            with writing(self._file):
                self._file.unlink(missing_ok=True)

    def open_again(self, output: Path | None) -> None:
        """Go on behind what is in the file. Raises DataError: it cannot be written, or is no results file."""
        if output is not None:
            self._file = output / TRUTH_FILE
            self._results = ResultsFile(self._file, 0, again=True) if self._file.exists() else None

    def record(self, step: Step) -> None:
        """One frame's true poses."""
        belief = step.sensed
        if self._file is None or "bodies" not in belief:
            return
        self._results = self._results or ResultsFile(self._file, 0)
        camera_from_world = invert(belief["camera"])
        objects: list[ScoredPose] = [
            {"obj_id": body["obj_id"], "pose": camera_from_world @ body["pose"], "score": 1.0, "status": "true"}
            for body in belief["bodies"]
        ]
        self._results.write(belief["frame"], objects)

    def close(self) -> None:
        """End the file."""
        if self._results is not None:
            self._results.close()
        self._results = None
