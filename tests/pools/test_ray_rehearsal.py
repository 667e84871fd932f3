"""Addresses at which there is no Ray cluster; see also the crash tests of joining."""

import pytest

from pfdist.errors import PoolError
from pfdist.pools import ray_rehearsal
from pfdist.pools.ray_rehearsal import host_and_port


@pytest.mark.parametrize(
    "address",
    [
        pytest.param("nonsense", id="no-port"),
        pytest.param(":6379", id="no-host"),
        pytest.param("head:", id="empty-port"),
        pytest.param("head:0", id="port-0"),
        pytest.param("head:65536", id="port-too-large"),
        pytest.param("head:" + "9" * 5000, id="port-of-5000-digits"),
        pytest.param("head:1_0", id="underscore"),
        pytest.param("head:٦٣٧٩", id="arabic-digits"),
        pytest.param("head:-1", id="negative"),
        pytest.param("a\0b:6379", id="nul"),
        pytest.param("a\nb:6379", id="two-lines"),
        pytest.param("x" * 3_000_000, id="three-megabytes"),
        pytest.param("ray://", id="scheme-alone"),
    ],
)
def test_what_is_no_address_is_refused_in_one_short_line(address: str) -> None:
    with pytest.raises(PoolError, match="must be host:port") as caught:
        host_and_port(address)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("head:6379", ("head", 6379)),
        ("ray://10.0.0.1:10001", ("10.0.0.1", 10001)),
        ("[::1]:6379", ("::1", 6379)),
        ("auto", ("", 0)),
    ],
)
def test_addresses_are_taken_apart(address: str, found: tuple[str, int]) -> None:
    assert host_and_port(address) == found


@pytest.mark.parametrize(
    ("host", "words"),
    [
        pytest.param("127.0.0.1", "Connection refused", id="closed-port"),
        pytest.param("a" * 64 + ".invalid", "nobody can be reached", id="label-too-long"),
        pytest.param("x" * 3000, "nobody can be reached", id="name-of-3000-letters"),
    ],
)
def test_where_nobody_listens_is_said_before_ray_is_loaded(host: str, words: str) -> None:
    with pytest.raises(PoolError, match=words) as caught:
        ray_rehearsal.reach(f"{host}:1")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250
