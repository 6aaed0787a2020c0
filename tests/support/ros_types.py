"""Types of ROS 2 that no wheel has, for rclpy: made by the generators of ROS's own wheels, and compiled.

    .venv/ros/bin/python tests/support/ros_types.py

writes the packages ``tf2_msgs`` and ``vision_msgs`` beside these wheels. It needs g++, and empy before its version 4.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np

os.environ["AMENT_PREFIX_PATH"] = sys.prefix  # before the generators ask for it

POSES, HEADER = "geometry_msgs::msg::", "std_msgs::msg::Header header;"
TYPES = {
    "tf2_msgs": {"TFMessage": f"sequence<{POSES}TransformStamped> transforms;"},
    "vision_msgs": {
        "BoundingBox3D": f"{POSES}Pose center; {POSES}Vector3 size;",
        "ObjectHypothesis": "string class_id; double score;",
        "ObjectHypothesisWithPose": f"vision_msgs::msg::ObjectHypothesis hypothesis; {POSES}PoseWithCovariance pose;",
        "Detection3D": f"{HEADER} sequence<vision_msgs::msg::ObjectHypothesisWithPose> results;"
        " vision_msgs::msg::BoundingBox3D bbox; string id;",
        "Detection3DArray": f"{HEADER} sequence<vision_msgs::msg::Detection3D> detections;",
    },
}
INCLUDED = [
    *(f"geometry_msgs/msg/{name}" for name in ("Pose", "PoseWithCovariance", "TransformStamped", "Vector3")),
    "std_msgs/msg/Header",
]


def main() -> None:
    """Make all packages."""
    prefix = Path(sys.prefix)
    for package, types in TYPES.items():
        with tempfile.TemporaryDirectory() as folder:
            shared = Path(folder)
            (shared / package / "msg").mkdir(parents=True)
            for name, fields in types.items():
                included = [
                    *INCLUDED,
                    *(f"{package}/msg/{other}" for other in types if f"::{other} " in fields.replace(">", " ")),
                ]
                lines = [f'#include "{each}.idl"' for each in included]
                lines.append(f"module {package} {{ module msg {{ struct {name} {{ {fields} }}; }}; }};")
                (shared / package / "msg" / f"{name}.idl").write_text("\n".join(lines))
            out = Path(sysconfig.get_path("purelib"), package)
            generate(
                package, [f"{shared / package}:msg/{name}.idl" for name in types], [str(prefix / "share"), folder], out
            )
            compile_into(package, out, prefix)


def generate(package: str, files: list[str], shared: list[str], out: Path) -> None:
    """Write the sources of a package's types."""
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

    out.mkdir(exist_ok=True)
    fast = ["rosidl_typesupport_fastrtps_c"]
    dispatch = GenerateCTypesupport("c", typesupport_implementations=fast)
    for each in (GenerateC("c"), GeneratePython("py"), dispatch, GenerateFastRTPSCTypesupport("fastrtps_c")):
        each.generate(package, files, shared, out)
    (out / "__init__.py").touch()


def compile_into(package: str, out: Path, prefix: Path) -> None:
    """Compile these sources into the module that rclpy imports."""
    places = [out.parent, sysconfig.get_path("include"), np.get_include(), prefix / "include"]
    places += (prefix / "include").iterdir()
    include = [f"-I{each}" for each in places]
    sources = [
        out / f"_{package}_s.ep.rosidl_typesupport_c.c",
        *(out / "msg").glob("*.c"),
        *(out / "msg" / "detail").glob("*.c"),
    ]
    plus = [*(out / "msg").glob("*.cpp"), *(out / "msg" / "detail").glob("*.cpp")]
    needed = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c")
    libraries = [
        f"-l{which}__{each}" for which in ("std_msgs", "geometry_msgs", "builtin_interfaces") for each in needed
    ]
    libraries += [f"-l{each}" for each in ("rosidl_runtime_c", "rosidl_typesupport_c", "fastcdr", "rcutils")]
    libraries += ["-lrosidl_typesupport_fastrtps_c", "-lrosidl_typesupport_fastrtps_cpp"]
    module = out / f"{package}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    with tempfile.TemporaryDirectory() as objects:
        for words, files in ((["gcc"], sources), (["g++", "-std=c++17"], plus)):
            subprocess.run([*words, "-O0", "-w", "-fPIC", "-c", *include, *map(str, files)], check=True, cwd=objects)
        linked = [str(each) for each in Path(objects).glob("*.o")]
        where = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}"]
        subprocess.run(["g++", "-shared", "-o", str(module), *linked, *where, *libraries], check=True)


if __name__ == "__main__":
    main()
