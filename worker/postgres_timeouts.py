"""How long a link to Postgres may be silent: one that is cut without a word is noticed and left."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

TIMEOUTS: dict[str, Any] = {
    "connect_timeout": 5,
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
}
"""Parameters of libpq. Keepalives end a connection that waits for an answer, and
`tcp_user_timeout` [ms] one whose request does not arrive: it would be sent again for minutes."""

SESSION_SETTINGS: dict[str, str] = {
    "idle_in_transaction_session_timeout": "15s",
    "tcp_keepalives_idle": "15s",
    "tcp_keepalives_interval": "5s",
    "tcp_keepalives_count": "3",
}
"""What the server does at its end: a host that vanishes within a transaction would keep the rows
that it has locked, and its connections, for hours."""


def session_options(url: sa.URL) -> dict[str, str]:
    """The parameter of libpq that asks for these settings; those that a URL asks for stay.

    Poolers refuse it, and have settings of their own.
    """
    given = url.query.get("options", "")
    asked = [given] if isinstance(given, str) else [*given]
    ours = [f"-c {name}={value}" for name, value in SESSION_SETTINGS.items()]
    return {"options": " ".join([*ours, *asked]).strip()}
