"""Keys, tokens and attachments as `rmw_zenoh` has them, by the figures of its sources; and two ends that talk."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
import xxhash
import zenoh
from support.launched import until
from support.topics import Talker, router, transforms

from hierax.nodes.ros2.by_zenoh import Endpoint, attachment_of, endpoint_of, qos_part, sent_at, topic_key
from hierax.nodes.ros2.carrier import LATCHED, QOS, address_of, open_carrier
from hierax.nodes.ros2.messages import messages
from hierax.nodes.sources.files import DataError

IMAGE_HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"


def test_keys_are_those_of_rmw_zenoh() -> None:
    kind = "sensor_msgs/msg/Image"
    assert messages().hash_rihs01(kind) == IMAGE_HASH
    key = topic_key(0, "/camera/image_raw", kind, IMAGE_HASH)
    assert key == f"0/camera/image_raw/sensor_msgs::msg::dds_::Image_/{IMAGE_HASH}"


def test_what_is_left_out_of_a_token_is_rmw_zenohs_default() -> None:
    """Reliable (1), volatile (2) and the last 42 messages (1, 42) are left out, as deadlines and so on are."""
    assert qos_part(QOS["reliable"]) == "::,10:,:,:,,"
    assert qos_part(QOS["reliable"]._replace(depth=42)) == "::,:,:,:,,"
    assert qos_part(QOS["sensor_data"]) == "2::,5:,:,:,,"
    assert qos_part(QOS["transient_local"]) == ":1:,1:,:,:,,"


@pytest.mark.parametrize(
    ("token", "expected"),
    [
        (
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/RIHS01_df/::,7:,:,:,,",
            Endpoint(True, "/chatter", "std_msgs/msg/String", "RIHS01_df"),
        ),
        (
            "@ros2_lv/2/aac3/0/10/MS/%/%arm/listener/%arm%tf/tf2_msgs::msg::dds_::TFMessage_/TypeHashNotSupported/::,7:,:,:,,/cpu",
            Endpoint(False, "/arm/tf", "tf2_msgs/msg/TFMessage", "TypeHashNotSupported"),
        ),
        ("@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker", None),
        ("@ros2_lv/2/aac3/0/11/SS/%/%/add/%add/a::srv::dds_::Add_/RIHS01_1/::,10:,:,:,,", None),
        ("@ros2_lv/2/aac3/0/11/MP/%/%/talker/%chatter", None),
        ("@other/2/aac3/0/11/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/RIHS01_df/::,7:,:,:,,", None),
    ],
)
def test_tokens_are_read_leniently(token: str, expected: Endpoint | None) -> None:
    assert endpoint_of(token) == expected


def test_attachments_have_33_bytes_and_those_of_old_are_read() -> None:
    gid = bytes(range(16))
    attachment = attachment_of(7, 1_700_000_000_123_456_789, gid)
    assert attachment == struct.pack("<qq", 7, 1_700_000_000_123_456_789) + b"\x10" + gid
    assert len(attachment) == 33
    assert sent_at(attachment) == 1_700_000_000_123_456_789
    old = b"\x0fsequence_number" + struct.pack("<q", 7) + b"\x10source_timestamp" + struct.pack("<q", 99)
    assert sent_at(old + b"\x0asource_gid\x10" + gid) == 99
    for cut in (b"", attachment[:9], old[:-3], b"x" * 40):
        assert sent_at(cut) is None


@pytest.mark.parametrize("sent_ns", [-1, 2**31 * 10**9, -(2**63), 2**63 - 1])
def test_a_time_of_sending_that_ros_does_not_have_is_none(sent_ns: int) -> None:
    """It would stand in for the stamp of what has none, and could not be published."""
    assert sent_at(struct.pack("<qq", 7, sent_ns) + b"\x10" + bytes(16)) is None
    assert sent_at(b"\x10source_timestamp" + struct.pack("<q", sent_ns)) is None


def test_settings_of_a_launch_are_not_those_of_ros(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "launch.json5").write_text('{connect: {endpoints: ["tcp/127.0.0.1:9"], timeout_ms: 1}}')
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / "launch.json5"))
    with router() as where, Talker(where) as one:
        until(lambda: not one.carrier.unreached(), "the router of the topic's name")


def test_two_ends_hear_one_another_and_who_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "41")
    with router() as where, Talker(where) as one, Talker(where) as other:
        seen: list[zenoh.Sample] = []
        watching = zenoh.open(zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["tcp/{where}"]}}}}'))
        watching.declare_subscriber("41/**", seen.append)
        message = transforms(5, "map", "lens", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
        one.say("/tf_static", message, LATCHED)
        late = other.hear("/tf_static", message.__msgtype__, LATCHED)  # after it was said
        until(lambda: len(late) == 1, "what was said before")
        assert late[0].transforms[0].transform.translation.y == 2.0
        heard = other.hear("/tf", message.__msgtype__)
        until(lambda: other.carrier.kinds("/tf_static") == {message.__msgtype__}, "who publishes is known")

        def again() -> bool:
            one.say("/tf", message)
            return len(heard) > 2 and any(str(each.key_expr).startswith("41/tf/") for each in seen)

        until(again, "what is said now")
        sample = next(each for each in seen if str(each.key_expr).startswith("41/tf/"))
        kind_hash = messages().hash_rihs01(message.__msgtype__)
        assert str(sample.key_expr) == f"41/tf/tf2_msgs::msg::dds_::TFMessage_/{kind_hash}"
        assert sample.attachment is not None
        attached = sample.attachment.to_bytes()
        tokens = [str(each.ok.key_expr) for each in watching.liveliness().get("@ros2_lv/41/**") if each.ok is not None]
        gids = {xxhash.xxh3_128_intdigest(each).to_bytes(16, "little") for each in tokens if "/MP/" in each}
        assert (len(attached), attached[17:] in gids) == (33, True)
        assert sample.payload.to_bytes()[:4] == b"\x00\x01\x00\x00"  # CDR, little-endian
        one.carrier.close()
        until(lambda: other.carrier.kinds("/tf_static") == set(), "who is gone is forgotten")
        watching.close()  # type: ignore[no-untyped-call]


def test_another_domain_hears_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with router() as where:
        monkeypatch.setenv("ROS_DOMAIN_ID", "42")
        with Talker(where) as one, Talker(where) as same:
            monkeypatch.setenv("ROS_DOMAIN_ID", "43")
            with Talker(where) as other:
                message = transforms(5, "map", "lens", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
                far, near = (each.hear("/tf", message.__msgtype__) for each in (other, same))

                def said() -> bool:
                    one.say("/tf", message)
                    return len(near) > 3

                until(said, "the same domain")
                assert (far, other.carrier.kinds("/tf")) == ([], set())


def test_what_cannot_be_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told = "robot_msgs/msg/Own is not known here; expected one of ROS's common types"
    with router() as where, Talker(where) as talker, pytest.raises(DataError, match=told):
        talker.carrier.publisher("/own", "robot_msgs/msg/Own", QOS["reliable"])
    for name, told in (
        ("ros+zenoh:/two words", "expected ros:/TOPIC"),
        ("ros://host:1/image", "expected ros:/TOPIC"),
        ("ros:", "expected ros:/TOPIC"),
        ("ros:/image?depth=3", "'depth': expected one of the options qos"),
        ("ros:/image?qos=best", "qos is 'best'; expected one of sensor_data, reliable, transient_local"),
    ):
        with pytest.raises(DataError, match=told):
            address_of(name, ("qos",))
    with pytest.raises(DataError, match="info is 'mine'; expected a topic with a slash in front"):
        address_of("ros:/image?info=mine", ("info",))
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(DataError, match="ROS_DOMAIN_ID is 'many'; expected a number from 0 to 232"):
        open_carrier(address_of("ros+zenoh:/image", ()), "test")
