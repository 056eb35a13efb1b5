"""A small S3 server on loopback: the wire protocol, objects in memory, no signatures."""

from __future__ import annotations

import hashlib
import re
import threading
from datetime import UTC, datetime
from email.utils import format_datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape


class S3(ThreadingHTTPServer):
    """Keeps `objects`: path "/bucket/key" -> (bytes, time of the last write)."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.objects: dict[str, tuple[bytes, datetime]] = {}
        self.down = False  # answer 503 to everything
        self.puts = 0
        self.lock = threading.Lock()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def close(self) -> None:
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: S3

    def log_message(self, *_: Any) -> None:
        """Say nothing."""

    def _answer(self, status: int, body: bytes = b"", **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        length = headers.get("Content_Length") or str(len(body))
        if "Content_Length" not in headers:
            self.send_header("Content-Length", length)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _place(self) -> tuple[str, dict[str, list[str]]]:
        parts = urlsplit(self.path)
        return unquote(parts.path), parse_qs(parts.query, keep_blank_values=True)

    def _body(self) -> bytes:
        data = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        if "aws-chunked" in (self.headers.get("Content-Encoding") or ""):
            raise AssertionError("chunked signatures are not spoken here")
        return data

    def _down(self) -> bool:
        if self.server.down:
            self._body()
            self._answer(503)
        return self.server.down

    def do_PUT(self) -> None:
        if self._down():
            return
        path, _ = self._place()
        data = self._body()
        with self.server.lock:
            self.server.puts += 1
            if self.headers.get("If-None-Match") == "*" and path in self.server.objects:
                self._answer(412)
                return
            self.server.objects[path] = (data, datetime.now(UTC))
        self._answer(200, ETag=_tag(data))

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        if self._down():
            return
        path, query = self._place()
        if "list-type" in query:
            self._list(path.strip("/"), query.get("prefix", [""])[0])
            return
        if path not in self.server.objects:
            self._answer(404)
            return
        data, written = self.server.objects[path]
        headers = {"ETag": _tag(data), "Last_Modified": format_datetime(written, usegmt=True)}
        status = 200
        if span := re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or ""):
            first, last = int(span[1]), int(span[2] or len(data) - 1)
            headers["Content_Range"] = f"bytes {first}-{min(last, len(data) - 1)}/{len(data)}"
            data, status = data[first : last + 1], 206
        self._answer(status, data, Content_Length=str(len(data)), **headers)

    def do_DELETE(self) -> None:
        if self._down():
            return
        self.server.objects.pop(self._place()[0], None)
        self._answer(204)

    def do_POST(self) -> None:
        if self._down():
            return
        path, query = self._place()
        body = self._body().decode()
        assert "delete" in query, self.path
        keys = re.findall(r"<Key>(.*?)</Key>", body)
        for key in keys:
            self.server.objects.pop(f"{path.rstrip('/')}/{key}", None)
        done = "".join(f"<Deleted><Key>{escape(key)}</Key></Deleted>" for key in keys)
        self._answer(200, f"<DeleteResult>{done}</DeleteResult>".encode())

    def _list(self, bucket: str, prefix: str) -> None:
        rows = [
            f"<Contents><Key>{escape(path.split('/', 2)[2])}</Key><Size>{len(data)}</Size>"
            f"<LastModified>{written:%Y-%m-%dT%H:%M:%S.000Z}</LastModified>"
            f"<ETag>{escape(_tag(data))}</ETag></Contents>"
            for path, (data, written) in sorted(self.server.objects.items())
            if path.startswith(f"/{bucket}/{prefix}")
        ]
        text = f"<ListBucketResult><IsTruncated>false</IsTruncated>{''.join(rows)}"
        self._answer(200, f"{text}</ListBucketResult>".encode())


def _tag(data: bytes) -> str:
    return f'"{hashlib.md5(data).hexdigest()}"'
