"""Messages by `rclpy`: of whatever middleware the user's ROS has. Imported only where it is asked for."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from typing import Any

from hierax.nodes.ros2.carrier import Carrier, Heard, Qos, domain
from hierax.nodes.sources.files import DataError, told_of

_END_S = 2.0


@contextmanager
def _asked(where: str) -> Iterator[None]:
    """`DataError` for whatever rclpy raises meanwhile: its errors have many kinds."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        raise DataError(f"{where}: rclpy refuses: {told_of(error)}; expected a ROS that works here") from error


class RclpyCarrier(Carrier):
    """A node of `rclpy`, in a context of its own, which a thread spins. Messages stay CDR, both ways: rclpy makes and
    reads none.

    Args: where: what asks for it, for errors; node: its name. Raises DataError: there is no rclpy, or it makes no
        node."""

    def __init__(self, where: str, node: str) -> None:
        self._where = where
        try:
            self._rclpy: Any = import_module("rclpy")
            executors, signals = import_module("rclpy.executors"), import_module("rclpy.signals")
            context = import_module("rclpy.context").Context()
        except ImportError as error:
            what = "a shell in which ROS's setup.bash was sourced, or ros+zenoh: in place of ros:"
            raise DataError(f"{where}: rclpy cannot be imported ({error}); expected {what}") from error
        quiet = signals.SignalHandlerOptions.NO
        options = {"enable_rosout": False, "start_parameter_services": False, "use_global_arguments": False}
        with _asked(where), ExitStack() as begun:
            self._rclpy.init(args=[], context=context, domain_id=domain(), signal_handler_options=quiet)
            begun.callback(self._rclpy.try_shutdown, context=context)
            self._node = self._rclpy.create_node(node, context=context, **options)
            self._executor = executors.SingleThreadedExecutor(context=context)
            self._executor.add_node(self._node)
            begun.pop_all()
        self._context = context
        self._ended = executors.ExternalShutdownException
        self._thread = threading.Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str, qos: Qos, heard: Heard) -> None:
        def came(data: bytes) -> None:
            heard(data, time.time_ns())

        with _asked(f"{self._where}: {topic}"):
            self._node.create_subscription(self._type(kind), topic, came, self._profile(qos), raw=True)

    def publisher(self, topic: str, kind: str, qos: Qos) -> Callable[[bytes], object]:
        with _asked(f"{self._where}: {topic}"):
            made: Any = self._node.create_publisher(self._type(kind), topic, self._profile(qos))
        publish: Callable[[bytes], object] = made.publish
        return publish

    def kinds(self, topic: str) -> set[str]:
        return {each.topic_type for each in self._node.get_publishers_info_by_topic(topic)}

    def close(self) -> None:
        self._executor.shutdown(timeout_sec=_END_S)
        self._rclpy.try_shutdown(context=self._context)
        self._thread.join(_END_S)
        if not self._thread.is_alive():  # what a callback still holds goes with the process
            self._node.destroy_node()

    def _spin(self) -> None:
        with suppress(self._ended):
            self._executor.spin()

    def _type(self, kind: str) -> Any:
        package, _, name = kind.partition("/msg/")
        try:
            return getattr(import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError) as error:
            what = f"the package {package}: apt install ros-$ROS_DISTRO-{package.replace('_', '-')}"
            raise DataError(f"{self._where}: ROS knows no {kind} here; expected {what}") from error

    def _profile(self, qos: Qos) -> Any:
        policies = import_module("rclpy.qos")
        reliability, durability = policies.ReliabilityPolicy, policies.DurabilityPolicy
        return policies.QoSProfile(
            depth=qos.depth,
            reliability=reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
            durability=durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        )
