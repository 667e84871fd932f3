"""Jobs that are explored, and their page on a real port."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pfdist import Job, load_job

SMALL = Path(__file__).parents[1] / "small.toml"
TOKEN = "a-token"


def job_of(*changes: str) -> Job:
    """The small job, which takes milliseconds to filter."""
    return load_job(SMALL, changes)


@contextlib.contextmanager
def served(session: Any, port: int = 0) -> Iterator[str]:
    """The address of the page of a session, as long as it is served."""
    from pfdist.plugins.explorer.server import ADDRESS, server_of  # it needs the extra `explore`

    listening = socket.create_server((ADDRESS, port))
    port = listening.getsockname()[1]
    server = server_of(session, TOKEN, port)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
    thread.start()
    try:
        yield f"http://{ADDRESS}:{port}/{TOKEN}/"
    finally:
        server.should_exit = True
        thread.join(20)
        listening.close()
