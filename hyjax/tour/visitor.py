"""Visitor: one page that is open. What it asks is answered in turn; of pictures it gets the newest alone."""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Any

import msgspec
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from hyjax.tour.messages import Message, number_of, read_message
from hyjax.util.errors import InputError

WAITING = 8
"""Most answers that wait to be sent; then no more of this visitor's messages are read."""
Answer = str | bytes
_log = logging.getLogger(__name__)


class Visitor:
    """Connection to a page. `show` and `tell` may be called from any thread.

    Attributes:
        message: the newest that asks for a picture; None before the first.
    """

    def __init__(
        self,
        wire: ServerConnection,
        requested: Callable[["Visitor", Message | None], None],
        answer: Callable[["Visitor", Message], Answer | None],
    ) -> None:
        self.message: Message | None = None
        self._wire, self._requested, self._answer = wire, requested, answer
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Queue[Answer | None] = asyncio.Queue(WAITING)
        self._picture: bytes | None = None
        self._told: dict[str, Any] = {}
        self._new = asyncio.Event()

    async def run(self) -> None:
        """Read messages until the page has gone."""
        works = self._read(), self._send_answers(), self._send_newest()
        tasks = [asyncio.ensure_future(work) for work in works]
        try:  # one that reads nothing and goes leaves the reader waiting for room
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()

    def show(self, picture: bytes) -> None:
        """Send a picture in the place of any that has not been sent yet."""
        self._call(self._renew, picture, {})

    def tell(self, **news: Any) -> None:
        """Send news; of those of one name that have not been sent yet the newest."""
        self._call(self._renew, None, news)

    def _renew(self, picture: bytes | None, news: dict[str, Any]) -> None:
        self._picture, self._told = picture or self._picture, self._told | news
        self._new.set()

    def send(self, answer: Answer) -> None:
        """Send an answer that took long to make; the oldest goes where too many wait."""

        def put() -> None:
            if self._waiting.full():
                self._waiting.get_nowait()
            self._waiting.put_nowait(answer)

        self._call(put)

    def _call(self, put: Callable[..., None], *what: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(put, *what)

    async def _take(self, text: str | bytes) -> Answer | None:
        try:
            message = read_message(text)
            if message.task == "picture":
                last, self.message = self.message, message
                self._requested(self, last)
                return None
            return await self._loop.run_in_executor(None, self._answer, self, message)
        except InputError as error:
            return refusal(error, number_of(text))
        except Exception:
            _log.exception("a request to the tour failed")
            return refusal(InputError("something went wrong; see the terminal for what it was"), number_of(text))

    async def _read(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            async for text in self._wire:
                await self._waiting.put(await self._take(text))

    async def _send_answers(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                if (answer := await self._waiting.get()) is not None:
                    await self._wire.send(answer)

    async def _send_newest(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._new.wait()
                self._new.clear()
                picture, self._picture = self._picture, None
                told, self._told = self._told, {}
                if told:
                    await self._wire.send(msgspec.json.encode(told).decode())
                if picture is not None:
                    await self._wire.send(picture)


def refusal(error: InputError, number: int | None) -> str:
    """Answer to what cannot be met."""
    return msgspec.json.encode({"number": number, "refused": str(error)[:500]}).decode()
