"""``hierax doctor``: what is wrong with this machine, and how it is mended."""

from typing import Annotated

from hierax.runtime.commands.options import Format, OutputFormat, option
from hierax.runtime.commands.show import print_json


def doctor(mend: Annotated[bool, option("--mend")] = False, output_format: OutputFormat = Format.text) -> int:
    """Look for what keeps launches from running well on this machine; exit code 1 where something is wrong."""
    from hierax.runtime.tools import doctor as doctors
    from hierax.runtime.tools.doctor import WRONG

    mended = doctors.mend() if mend else []
    findings = list(doctors.examine())
    wrong = [finding for finding in findings if finding.state == WRONG]
    if output_format is Format.json:
        print_json({"mended": mended, "findings": [each._asdict() for each in findings], "wrong": len(wrong)})
    else:
        print(*mended, sep="\n", end="\n" if mended else "")
        for finding in findings:
            print(f"{finding.state:5}  {finding.check}: {finding.what}")
            if finding.mend:
                print(f"       -> {finding.mend}")
        print(f"{len(wrong)} wrong" if wrong else "nothing is wrong")
    return int(bool(wrong))
