"""One HTTP exchange with the service: sends, repeats what is safe to repeat, turns refusals into errors."""

import json
import re
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final, TypeAlias

import httpx2

from service.client.display import Parts, counting
from service.client.errors import (
    BounceError,
    Busy,
    InvalidSpecification,
    NotComputedYet,
    Problem,
    Refused,
    ServiceUnreachable,
    UnexpectedAnswer,
    refusal,
)

#: Seconds before the second and third attempt of a call that may be repeated.
PAUSES: Final = (0.1, 0.4)

#: The request did not arrive, or its answer did not.
EVENTS_SECONDS: Final = 60.0  # without a sign of life among events; the service gives one every 15
DOWNLOAD_SECONDS: Final = 600.0  # until a file is made

_LOST: Final = (httpx2.NetworkError, httpx2.RemoteProtocolError)

Query: TypeAlias = Mapping[str, str | float | None]


class Transport:
    """Speaks to one service at `url`; `http` (closed by its owner) carries the requests if given."""

    def __init__(self, url: str, *, token: str | None, timeout: float, http: httpx2.Client | None) -> None:
        self.url = _checked(url)
        self._owned = http is None
        self._http = http or httpx2.Client(
            timeout=httpx2.Timeout(timeout, connect=min(timeout, 5.0)),
            trust_env=not _is_loopback(self.url),  # a proxy cannot reach this machine's own loopback
        )
        self._headers = {"Accept": "application/json", "User-Agent": "bouncing-spring"}
        if token:  # as for the service, an empty variable is none
            self._headers["Authorization"] = f"Bearer {word('the token', token)}"

    def close(self) -> None:
        """Close the connections, unless they were lent."""
        if self._owned:
            self._http.close()

    def get(
        self, path: str, query: Query | None = None, headers: Mapping[str, str] | None = None
    ) -> httpx2.Response:
        """GET `path`; None in `query` is left out. Raises the errors of `service.client.errors`."""
        return self._exchange("GET", path, query=query, headers=headers, repeat=True)

    def get_when_computed(
        self, path: str, query: Query | None = None, *, patience: float, progress: bool | Parts
    ) -> httpx2.Response:
        """GET what workers have to compute first, asking again for `patience` seconds while they do.

        Raises NotComputedYet after that, or Busy where the service could not take the question.
        """
        give_up = time.monotonic() + patience
        show = counting(progress)
        while True:
            try:
                answer = self.get(path, query)
                if answer.status_code != 202:
                    return answer
                pause, (done, total) = seconds_to_wait(answer), _parts(answer)
                show(done, total)
                if time.monotonic() > give_up:
                    raise NotComputedYet(done, total, patience)
            except Busy as busy:
                if time.monotonic() > give_up:
                    raise
                pause = busy.retry_after
            time.sleep(pause or 1.0)

    def post(
        self,
        path: str,
        body: bytes | None = None,
        *,
        query: Query | None = None,
        headers: Mapping[str, str] | None = None,
        repeat: bool = False,
    ) -> httpx2.Response:
        """POST `body` (JSON); `repeat` says that doing it twice is the same as doing it once."""
        kind = {"Content-Type": "application/json"} if body is not None else {}
        headers = {**kind, **(headers or {})}
        return self._exchange("POST", path, query=query, headers=headers, body=body, repeat=repeat)

    def delete(self, path: str) -> None:
        """DELETE `path`; not repeated, because what is gone is not found the second time."""
        self._exchange("DELETE", path, repeat=False)

    def events(self, path: str) -> Iterator[dict[str, Any]]:
        """The data of server-sent events, each a JSON object, as they come."""
        with self._streaming(path, None, EVENTS_SECONDS) as response:
            for line in response.iter_lines():
                if line.startswith("data: "):
                    yield json.loads(line.removeprefix("data: "))

    def download(self, path: str, query: Query, target: Path) -> None:
        """GET into a file, which appears under its name once it is whole."""
        with (
            self._streaming(path, query, DOWNLOAD_SECONDS) as response,
            tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}.", delete=False) as file,
        ):
            draft = Path(file.name)
            try:
                for piece in response.iter_bytes():
                    file.write(piece)
                file.close()
                draft.replace(target)
            finally:
                draft.unlink(missing_ok=True)

    @contextmanager
    def _streaming(self, path: str, query: Query | None, seconds: float) -> Iterator[httpx2.Response]:
        """An answer that is read as it comes; `seconds` may pass without any of it."""
        request = self._http.build_request(
            "GET",
            self.url + path,
            params={name: value for name, value in (query or {}).items() if value is not None},
            headers=self._headers,
            timeout=httpx2.Timeout(seconds, connect=5.0),
        )
        try:
            with closing(self._http.send(request, stream=True)) as response:
                if not response.is_success:
                    response.read()
                yield self._accepted(response)
        except httpx2.RequestError as error:
            raise ServiceUnreachable(self.url, _reason(error)) from error

    def _exchange(
        self,
        method: str,
        path: str,
        *,
        query: Query | None = None,
        headers: Mapping[str, str] | None = None,
        body: bytes | None = None,
        repeat: bool,
    ) -> httpx2.Response:
        request = self._http.build_request(
            method,
            self.url + path,
            params={name: value for name, value in (query or {}).items() if value is not None},
            headers={**self._headers, **(headers or {})},
            content=body,
        )
        return self._accepted(self._sent(request, PAUSES if repeat else ()))

    def _sent(self, request: httpx2.Request, pauses: tuple[float, ...]) -> httpx2.Response:
        """Send, and again after each of `pauses` while the connection is lost."""
        try:
            return self._http.send(request)
        except _LOST as error:
            if not pauses:
                raise ServiceUnreachable(self.url, _reason(error)) from error
        except httpx2.TimeoutException as error:
            raise ServiceUnreachable(self.url, "no answer in time") from error
        except httpx2.RequestError as error:
            raise UnexpectedAnswer(f"{self.url} does not speak HTTP as expected: {_reason(error)}") from error
        time.sleep(pauses[0])
        return self._sent(request, pauses[1:])

    def _accepted(self, response: httpx2.Response) -> httpx2.Response:
        """The response if it is a success or a 304; otherwise raise what it says."""
        if response.is_success or response.status_code == 304:
            return response
        if response.status_code >= 400:
            raise self._refusal(response)
        raise UnexpectedAnswer(
            f"{response.request.url} answered {response.status_code}, not a bounce service"
        )

    def _refusal(self, response: httpx2.Response) -> Refused:
        status, reason = response.status_code, response.reason_phrase
        problem = Problem.from_json(_problem_document(response), status=status, reason=reason)
        kind = refusal(status)
        if (
            status in (400, 422)
            and response.request.method == "POST"
            and _is_submission(response.request.url)
        ):
            kind = InvalidSpecification
        return kind(problem, retry_after=seconds_to_wait(response))


def document(response: httpx2.Response) -> dict[str, Any]:
    """The JSON object a response carries; anything else is not this service's answer."""
    try:
        content = response.json()
    except ValueError:
        content = None
    if not isinstance(content, dict):
        raise UnexpectedAnswer(
            f"{response.request.url} did not answer with a JSON object: not a bounce service"
        )
    return content


def _parts(response: httpx2.Response) -> tuple[int, int]:
    """How many parts of an answer are computed, and of how many."""
    try:
        progress = document(response)["progress"]
        return int(progress["parts_done"]), int(progress["parts_total"])
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedAnswer(f"{response.request.url} did not say how far it is: {error!r}") from error


def seconds_to_wait(response: httpx2.Response) -> float | None:
    """`Retry-After` in seconds; None when it is missing, negative or a date."""
    try:
        seconds = float(response.headers.get("Retry-After", ""))
    except ValueError:
        return None
    return seconds if 0 <= seconds < float("inf") else None


def _problem_document(response: httpx2.Response) -> dict[str, Any]:
    """The problem document, or one made up from the status line (a proxy answers in HTML)."""
    try:
        return document(response)
    except UnexpectedAnswer:
        return {"detail": f"{response.request.url} answered {response.status_code} {response.reason_phrase}"}


def word(name: str, given: str) -> str:
    """What a header can carry; not repeated if it cannot, it may be secret. Raises BounceError."""
    if not re.fullmatch("[!-~]+", given):
        raise BounceError(f"{name} must be made of ASCII characters, without spaces")
    return given


def _checked(url: str) -> str:
    """The address without a trailing slash. Raises ServiceUnreachable if it cannot be one."""
    try:
        parsed = httpx2.URL(url)
    except httpx2.InvalidURL as error:
        raise ServiceUnreachable(url, f"not an address: {error}") from error
    if parsed.scheme not in ("http", "https") or not parsed.host:
        raise ServiceUnreachable(url, "an address reads http://HOST:PORT")
    return url.rstrip("/")


def _is_loopback(url: str) -> bool:
    host = httpx2.URL(url).host
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _is_submission(url: httpx2.URL) -> bool:
    return url.path.endswith("/v1/jobs")


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__
