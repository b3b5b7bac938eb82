"""HTTP requests to one service: retries safe requests, turns problem documents into exceptions."""

import json
import os
import re
import ssl
import time
import weakref
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar

import httpx2

from service.client.display import display_elapsed, display_line, display_parts
from service.client.errors import (
    BadRequest,
    Busy,
    InvalidSpecification,
    NotComputedYet,
    ServiceUnreachable,
    Unanswered,
    UnexpectedAnswer,
    error_class,
)
from service.client.models import Problem
from service.formats import Progress
from service.tokens import AUTO, find_token, is_loopback
from worker.files import complete_file
from worker.spec.errors import BounceError

CONNECT_SECONDS: Final = 5.0
#: A socket takes no time limit above 2**31 ms.
LONGEST_TIMEOUT: Final = 2e6

#: Seconds before the second and the third attempt at an idempotent request.
RETRY_DELAYS: Final = (0.1, 0.4)

#: Default and shortest seconds between two requests to a service that is busy or away.
ASK_DELAY: Final = 1.0
SHORTEST_DELAY: Final = 0.1
#: Seconds of waiting for a busy or absent service before it is reported.
SHOWN_AFTER: Final = 2.0

#: Seconds for which a wait outlasts a service that is away; a restarted one continues its jobs.
MAX_OUTAGE: Final = 30.0

#: Seconds without data before a download fails; the service writes the file before it sends it.
DOWNLOAD_SECONDS: Final = 600.0

#: Bytes of an answer after decompression; the service's own limit on all answers together is twice that.
MAX_ANSWER_BYTES: Final = 256 * 2**20

#: The connection broke: the request or its answer did not arrive.
_CONNECTION_LOST: Final = (httpx2.NetworkError, httpx2.RemoteProtocolError)

Query: TypeAlias = Mapping[str, str | float | None]
Answer = TypeVar("Answer")


def outlast(
    send: Callable[[], Answer], *, away: float = MAX_OUTAGE, busy: float = MAX_OUTAGE, queues: bool = True,
    shown: bool = False,
) -> Answer:  # fmt: skip
    """What `send` returns, repeated while the service does not answer.

    For up to `away` seconds where it is away, `busy` where a proxy passes nothing on or, with `queues`, the
    service is full (429). Raises ServiceUnreachable or Busy. shown: whether waits longer than SHOWN_AFTER are
    shown on standard error.
    """
    began = answered = time.monotonic()
    with ExitStack() as waiting:
        while True:
            try:
                return send()
            except (ServiceUnreachable, Busy) as error:
                now = time.monotonic()
                asked, full = None, False
                if isinstance(error, Busy):
                    asked, full = error.retry_after, error.of_proxy or (queues and error.status == 429)
                answered = now if full else answered
                left = (began + busy if full else answered + away) - now
                if left <= 0.0:
                    raise
            if full and shown:
                waiting.enter_context(display_elapsed("the service is busy: waiting", SHOWN_AFTER))
                shown = False
            elif shown and now - answered >= SHOWN_AFTER:
                display_line(f"the service does not answer: waiting up to {left:.0f} s for it")
                shown = False
            time.sleep(_pause(asked, left))


class Transport:
    """Sends requests to the service at `url`, with `http` if given, which its owner closes.

    Every method raises the exceptions of `service.client.errors`. Parameters that are None are omitted from
    the query. Pickled, it includes the token and opens connections of its own.
    """

    def __init__(
        self, url: str, token: str | None, timeout: float, http: httpx2.Client | None = None
    ) -> None:
        self.url, self._timeout = _valid_url(url), min(timeout, LONGEST_TIMEOUT)
        self._headers = {"Accept": "application/json", "User-Agent": "bouncing-spring"}
        if token in (None, "", AUTO):  # an empty variable means no token
            address = httpx2.URL(self.url)
            # of this user's service, if it listens there
            token = find_token(address.port) if address.port and is_loopback(address.host) else None
        self.token = token
        if token is not None:
            self._headers["Authorization"] = f"Bearer {header_value('the token', token)}"
        self._http, self._is_own = http or self._connections(), http is None
        self.close: Callable[[], object] = lambda: None
        if self._is_own:
            self._note_process()

    def _note_process(self) -> None:
        self._process, self.close = os.getpid(), weakref.finalize(self, self._http.close)

    def _send(self, request: httpx2.Request) -> httpx2.Response:
        """The response, its body not yet read.

        A forked process opens connections of its own: on shared ones each would read the other's answers.
        """
        if self._is_own and self._process != os.getpid():
            self._http = self._connections()
            self._note_process()
        if self._http.is_closed:
            raise BounceError("the client is closed")
        return self._http.send(request, stream=True)

    def _connections(self) -> httpx2.Client:
        own_loopback = is_loopback(httpx2.URL(self.url).host)
        verify: bool | ssl.SSLContext = True
        if own_loopback:  # loading certificates takes 20 ms; without trust_env httpx ignores SSL_CERT_FILE
            verify = False if self.url.startswith("http:") else ssl.create_default_context()
        return httpx2.Client(
            timeout=httpx2.Timeout(self._timeout, connect=min(self._timeout, CONNECT_SECONDS)),
            trust_env=not own_loopback,  # a proxy cannot reach this machine's own loopback
            verify=verify,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return Transport, (self.url, self.token, self._timeout)

    def get(
        self, path: str, query: Query | None = None, headers: Mapping[str, str] | None = None
    ) -> httpx2.Response:
        """GET `path`; a 304 is returned like a success. Waits for a busy service."""
        send = partial(self._request, "GET", path, query, headers)
        return outlast(send, away=0.0, busy=self._timeout, shown=True)

    def post(
        self,
        path: str,
        body: bytes | None = None,
        *,
        query: Query | None = None,
        headers: Mapping[str, str] | None = None,
        waits: bool = False,
    ) -> httpx2.Response:
        """POST `body` (JSON); a repeated request must have the effect of a single one.

        waits: whether to wait for a busy service, like `get`.
        """
        content_type = {"Content-Type": "application/json"} if body is not None else {}
        send = partial(self._request, "POST", path, query, {**content_type, **(headers or {})}, body)
        return outlast(send, away=0.0, busy=self._timeout, queues=waits, shown=True)

    def delete(self, path: str) -> None:
        """DELETE `path`; not retried, because a second request would find nothing."""
        self._request("DELETE", path, delays=())

    def get_result(
        self,
        path: str,
        format: str,
        *,
        timeout: float = 300.0,
        progress: Progress = True,
        content: bytes | None = None,
        **query: Any,
    ) -> bytes:
        """The body of a result in this format, waiting up to `timeout` seconds while workers compute it.

        content: the JSON that a POST sends; without it the result is requested with GET.
        `progress`: True writes the finished parts to standard error; a function is called with their number
        and the total. Raises NotComputedYet after the timeout, or Busy if the service is still busy then.
        """
        query = {name: str(x).lower() if isinstance(x, bool) else x for name, x in query.items()}
        method, headers = ("GET", {}) if content is None else ("POST", {"Content-Type": "application/json"})
        send = partial(self._request, method, path, {**query, "format": format}, headers, content)
        deadline = time.monotonic() + timeout
        show, away, noticed = display_parts(progress), 0.0, None
        while True:
            left = deadline - time.monotonic()
            response = outlast(send, away=min(away, left), busy=left, shown=progress is not False)
            away = MAX_OUTAGE
            if response.status_code != HTTPStatus.ACCEPTED:
                return response.content
            done, total = _parts_computed(response)
            show(done, total)
            if progress is True and (notice := json_object(response).get("notice")) not in (None, noticed):
                display_line(noticed := notice)
            if (left := deadline - time.monotonic()) <= 0.0:
                raise NotComputedYet(done, total, timeout)
            time.sleep(_pause(retry_after(response), left))

    def download(self, path: str, query: Query, target: Path, end: bytes = b"") -> None:
        """GET into the file `target`, replaced once it is complete with `end` after it. Waits like `get`."""

        def save(response: httpx2.Response) -> httpx2.Response:
            with complete_file(target) as file:
                for block in response.iter_bytes():
                    file.write(block)
                file.write(end)
            return response

        # the reader of a pipe or terminal has what came so far
        delays = RETRY_DELAYS if target.is_file() or not target.exists() else ()
        send = partial(self._request, "GET", path, query, delays=delays, read=save, seconds=DOWNLOAD_SECONDS)
        outlast(send, away=0.0, busy=DOWNLOAD_SECONDS, shown=True)

    def _request(
        self,
        method: str,
        path: str,
        query: Query | None = None,
        headers: Mapping[str, str] | None = None,
        body: bytes | None = None,
        delays: tuple[float, ...] = RETRY_DELAYS,
        read: Callable[[httpx2.Response], httpx2.Response] | None = None,
        seconds: float | None = None,
    ) -> httpx2.Response:
        """The response, requested again after each of `delays` while the connection breaks.

        read: reads the body of a success. seconds: at most between two pieces, by default the timeout.
        """
        limit = self._http.timeout if seconds is None else httpx2.Timeout(seconds, connect=CONNECT_SECONDS)
        values = {name: _text(value) for name, value in (query or {}).items() if value is not None}
        sent = {**self._headers, **(headers or {})}
        try:
            request = self._http.build_request(
                method, self.url + path, params=values, headers=sent, content=body, timeout=limit
            )
            with closing(self._send(request)) as response:
                checked = _checked(response if response.is_success else _whole(response))
                return (read or _whole)(checked)
        except (httpx2.InvalidURL, UnicodeError) as error:
            detail = f"no address can hold what is asked for: {error}"
            raise BadRequest(Problem(status=400, title="Bad Request", detail=detail)) from None
        except httpx2.RequestError as error:
            if not (delays and isinstance(error, _CONNECTION_LOST)):
                raise self._failure(error, seconds or self._timeout) from None
        time.sleep(delays[0])
        return self._request(method, path, query, headers, body, delays[1:], read, seconds)

    def _failure(self, error: httpx2.RequestError, seconds: float) -> BounceError:
        """The error of a request without an answer within `seconds`, in one sentence."""
        reason = str(error) or type(error).__name__
        if "CERTIFICATE_VERIFY_FAILED" in reason:
            unknown = "self-signed" in reason or "issuer" in reason
            rule = "; SSL_CERT_FILE may name a file of the authorities that you trust" if unknown else ""
            return UnexpectedAnswer(f"the certificate of {self.url} is not trusted ({reason}){rule}")
        if "WRONG_VERSION_NUMBER" in reason or "RECORD_LAYER_FAILURE" in reason:
            return UnexpectedAnswer(f"{self.url} does not speak TLS: its address may begin with http://")
        if isinstance(error, (httpx2.ConnectError, httpx2.ConnectTimeout)):
            return ServiceUnreachable(self.url, reason)
        if isinstance(error, httpx2.TimeoutException):
            return Unanswered(
                self.url,
                f"nothing came in time ({seconds:g} s), it may be busy: repeat the request, or give the "
                "client a longer timeout",
            )
        if isinstance(error, _CONNECTION_LOST):
            return Unanswered(self.url, f"the connection broke ({reason}): repeat the request")
        return UnexpectedAnswer(f"{self.url} does not speak HTTP as expected: {reason}")


def _text(value: Any) -> Any:
    """A value of a query: lists and numpy arrays as their values with commas."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else value


def _checked(response: httpx2.Response) -> httpx2.Response:
    """The response if it is a success or a 304; raises the exception of its status otherwise."""
    status, request, answered = response.status_code, response.request, response.headers
    # A proxy asks to log in; pages of the service are attachments.
    is_page = "text/html" in answered.get("Content-Type", "") and "Content-Disposition" not in answered
    if status in (HTTPStatus.NOT_MODIFIED, HTTPStatus.NO_CONTENT):
        return response
    if response.is_success and not is_page:
        if response.http_version < "HTTP/2" and not answered.keys() & {"content-length", "transfer-encoding"}:
            raise UnexpectedAnswer(f"{request.url} answered without a length: a proxy may have cut it")
        return response
    if status < 400:
        rule = ", not as a bounce service does"
        with suppress(KeyError, httpx2.InvalidURL):
            target = request.url.join(answered["Location"])
            shown = target.copy_with(userinfo=b"", query=None, fragment=None)  # the rest may be secret
            rule = f" and sends on to {shown}: if the service is there, give its address"
        raise UnexpectedAnswer(f"{request.url} answered {status}{rule}")
    answer = f"{status} {response.reason_phrase}"
    if status == HTTPStatus.BAD_GATEWAY:  # as without the proxy
        raise httpx2.RemoteProtocolError(f"a proxy said {answer}")
    if status == HTTPStatus.GATEWAY_TIMEOUT:
        raise Unanswered(str(request.url), f"a proxy said {answer}: repeat the request")
    of_proxy = False
    try:
        document = json_object(response)
    except UnexpectedAnswer:  # a proxy answers in HTML
        if status == HTTPStatus.NOT_FOUND:  # what it does not find may be there
            raise
        rule = ": its port may take https:// only" if (status, request.url.scheme) == (400, "http") else ""
        document, of_proxy = {"detail": f"{request.url} answered {answer}, as of a proxy{rule}"}, True
    is_submission = request.method == "POST" and request.url.path.endswith("/v1/jobs")
    error = InvalidSpecification if is_submission and status in (400, 422) else error_class(status)
    problem = Problem.from_json(document, status=status, reason=response.reason_phrase)
    raise error(problem, retry_after=retry_after(response), of_proxy=of_proxy)


def _whole(response: httpx2.Response) -> httpx2.Response:
    """The response with its body read and decompressed. Raises UnexpectedAnswer above MAX_ANSWER_BYTES."""
    content = bytearray()
    for block in response.iter_bytes():
        content += block
        if len(content) > MAX_ANSWER_BYTES:
            raise UnexpectedAnswer(
                f"{response.url} sends more than {MAX_ANSWER_BYTES // 2**20} MiB, as no bounce service does"
            )
    of_transfer = ("content-encoding", "content-length", "transfer-encoding")
    headers = [pair for pair in response.headers.multi_items() if pair[0].lower() not in of_transfer]
    return httpx2.Response(
        response.status_code, headers=headers, content=bytes(content), request=response.request
    )


def json_object(response: httpx2.Response) -> dict[str, Any]:
    """The JSON object in the body. Raises UnexpectedAnswer for any other body."""
    content = None
    with suppress(ValueError, RecursionError):
        content = json.loads(response.content)
    if not isinstance(content, dict):
        raise UnexpectedAnswer(
            f"{response.url} answered {response.status_code}, not as a bounce service does"
        )
    return content


def retry_after(response: httpx2.Response) -> float | None:
    """`Retry-After` in seconds; None if it is missing, negative or a date."""
    try:
        seconds = float(response.headers.get("Retry-After", ""))
    except ValueError:
        return None
    return seconds if 0 <= seconds < float("inf") else None


def _pause(asked: float | None, left: float) -> float:
    """Seconds until the next request: the service asked for `asked`, the caller has `left`."""
    return min(max(asked or ASK_DELAY, SHORTEST_DELAY), left)


def header_value(name: str, text: str) -> str:
    """`text` if a header can carry it. Raises BounceError without quoting `text`, which may be secret."""
    if not re.fullmatch("[!-~]+", text):
        raise BounceError(f"{name} must consist of ASCII characters without spaces")
    return text


def _parts_computed(response: httpx2.Response) -> tuple[int, int]:
    try:
        progress = json_object(response)["progress"]
        return int(progress["parts_done"]), int(progress["parts_total"])
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedAnswer(f"{response.request.url} answered 202 without progress: {error!r}") from error


def _valid_url(url: str) -> str:
    """The address without a trailing slash.

    Raises ServiceUnreachable if it is not an HTTP address, without any part that may be a password.
    """
    parsed = httpx2.URL()
    with suppress(httpx2.InvalidURL):
        parsed = httpx2.URL(url)
    shown = re.sub("(?s)[?#].*", "", re.sub("(?s).*@", "...@", url))  # the page's address may have a token
    if parsed.scheme not in ("http", "https") or not parsed.host or parsed.userinfo or re.search("[?#]", url):
        raise ServiceUnreachable(shown, "expected an address like http://HOST:PORT")
    return url.rstrip("/")
