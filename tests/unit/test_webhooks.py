"""Signatures of messages to webhooks, and the addresses they may go to."""

from __future__ import annotations

import ipaddress

import anyio
import pytest

from chamfer_morph.worker.webhooks.signature import check_secret, new_secret, sign
from chamfer_morph.worker.webhooks.targets import parse_url, resolve
from morph_engine.errors import ConfigError


def test_the_signature_is_that_of_the_standard() -> None:
    """Its documentation computes this one."""
    signature = sign(
        "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
        "msg_p5jXN8AQM9LWM0D4loKWxJek",
        1614265330,
        b'{"test": 2432232314}',
    )
    assert signature == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_secrets() -> None:
    """Ours are accepted and differ; too short or garbled ones are not."""
    assert new_secret() != new_secret()
    check_secret(new_secret())
    for wrong in ("whsec_c2hvcnQ=", "whsec_" + "A" * 33, "whsec_" + "A" * 400, "A" * 44):
        with pytest.raises(ConfigError):
            check_secret(wrong)


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1", "localhost", "2130706433", "0.0.0.0", "10.0.0.1", "192.168.1.1", "172.16.0.1",
        "169.254.169.254", "100.64.0.1", "224.0.0.1", "240.0.0.1", "255.255.255.255", "::1", "::",
        "::ffff:127.0.0.1", "::ffff:10.0.0.1", "fe80::1", "fc00::1", "ff02::1", "2002:7f00:1::",
        "64:ff9b::7f00:1",
    ],
)  # fmt: skip
def test_no_message_goes_to_addresses_that_are_not_public(host: str) -> None:
    """However they are written; unless their network is allowed."""
    with pytest.raises(ConfigError, match="which is not a public address"):
        anyio.run(resolve, host, 80, ())


def test_allowed_networks() -> None:
    """They are reached, and no others."""
    allowed = [ipaddress.ip_network("127.0.0.0/8"), ipaddress.ip_network("::1/128")]
    assert anyio.run(resolve, "127.0.0.1", 80, allowed) == ["127.0.0.1"]
    assert anyio.run(resolve, "::ffff:127.0.0.1", 80, allowed)
    assert anyio.run(resolve, "8.8.8.8", 80, allowed) == ["8.8.8.8"]
    with pytest.raises(ConfigError):
        anyio.run(resolve, "10.0.0.1", 80, allowed)


@pytest.mark.parametrize(
    "url",
    ["ftp://example.com", "http://", "example.com", "https://ann:word@example.com", "http://a/#b",
     "file:///etc/passwd", "http://[::1", "http://example.com:99999"],
)  # fmt: skip
def test_urls_that_are_refused(url: str) -> None:
    """Only http and https, without a password or a fragment."""
    with pytest.raises(ConfigError):
        parse_url(url)
