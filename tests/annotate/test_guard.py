"""Who may ask the page's server for what: one page, on this machine, with this start's token."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
from urllib.parse import quote

import pytest

from spinestiff.loopback.guard import LARGEST_BODY, TOKEN_HEADER, Access, Guard, own_origins
from spinestiff.loopback.serving import listening
from unannotated import CANARY

DATA = [
    ("GET", "/api/session"),
    ("GET", "/api/radiograph?image=rest/frontal"),
    ("PUT", "/api/annotation"),
    ("POST", "/api/judge"),
    ("POST", "/api/propose"),
    ("POST", "/api/import"),
    ("GET", "/api/export?form=csv"),
    ("GET", "/api/track?image=push/a"),
    ("POST", "/api/track"),
]
EMPTY = {"revision": "", "draft": {"schema_version": 1, "images": {}}}


def test_nothing_is_given_or_taken_without_the_token(served):
    for method, path in DATA:
        body = EMPTY if method != "GET" else None
        for token in ("", "x" * len(served.token), served.token[:-1], served.token + "x", "é" * 20):
            status, _, answer = served.ask(method, path, body, token=token)
            assert status == 403, (method, path, token)
            assert set(json.loads(answer)) == {"error"}, (method, path, token)
        assert served.ask(method, path, body, {TOKEN_HEADER: None})[0] == 403, (method, path)
    assert not served.session.annotation_path.exists() and not served.session.draft_path.exists()
    # With it the same request comes through to where it is judged by its content.
    for method, path in DATA:
        status, _, _ = served.ask(method, path, EMPTY if method != "GET" else None)
        assert status in (200, 409, 422), (method, path)


def test_every_route_for_data_is_among_those_tested(served):
    from fastapi.routing import APIRoute

    from spinestiff.annotate.server import application

    routes = [route for route in application(served.session).routes if isinstance(route, APIRoute)]
    data = {(method, route.path) for route in routes for method in route.methods if route.path.startswith("/api/")}
    assert data == {(method, path.partition("?")[0]) for method, path in DATA}
    assert {route.path for route in routes} - {path for _, path in data} == {"/", "/annotate.js", "/annotate.css"}


def test_a_token_is_of_one_start(served, session):
    from spinestiff.annotate.server import guarded_application

    tokens = {guarded_application(session, 1)[0].token for _ in range(5)} | {served.token}
    assert len(tokens) == 6 and min(map(len, tokens)) >= 40


FOREIGN = ("evil.example", "127.0.0.1", "localhost", "127.0.0.1:1", "evil.example:{port}", "127.0.0.1:{port}.x", "")


def test_a_foreign_host_is_refused(served):
    """DNS rebinding: a foreign name that leads here."""
    for host in FOREIGN:
        for path in ("/", "/api/session"):
            status, _, _ = served.ask("GET", path, headers={"Host": host.format(port=served.port)})
            assert status == 421, (host, path)


def test_the_machines_own_names_are_answered(served):
    for host in ("127.0.0.1", "localhost"):
        assert served.ask("GET", "/api/session", headers={"Host": f"{host}:{served.port}"})[0] == 200


@pytest.mark.parametrize(("port", "end"), [(80, ""), (8080, ":8080")])
def test_a_browsers_host_and_origin_are_the_pages_own_at_every_port(port, end):
    """As browsers write them: without the port of HTTP (RFC 6454, 6.2)."""

    async def page(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive():
        return {"type": "http.request"}

    async def status(host, origin):
        sent = []

        async def send(message):
            sent.append(message)

        headers = [(b"host", host.encode()), (b"origin", origin.encode())]
        scope = {"type": "http", "method": "GET", "path": "/", "headers": headers}
        await Guard(page, Access("token", own_origins(port)))(scope, receive, send)
        return sent[0]["status"]

    for host in ("127.0.0.1", "localhost"):
        assert asyncio.run(status(f"{host}{end}", f"http://{host}{end}")) == 200
        assert asyncio.run(status(f"{host}:1", f"http://{host}:1")) == 421


def test_a_request_with_two_hosts_or_none_is_refused(served):
    for lines in ([f"Host: 127.0.0.1:{served.port}", "Host: evil.example"], []):
        with socket.create_connection(("127.0.0.1", served.port), timeout=20) as sock:
            head = "\r\n".join(["GET /api/session HTTP/1.1", *lines, f"{TOKEN_HEADER}: {served.token}", "", ""])
            sock.sendall(head.encode())
            answer = sock.recv(1000).split(b"\r\n")[0]
        assert answer.split()[1] in (b"400", b"421"), answer


def test_a_foreign_origin_is_refused_even_with_the_token(served):
    for origin in ("http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1",
                   "http://localhost:{port}"):  # fmt: skip
        headers = {"Origin": origin.format(port=served.port)}
        assert served.ask("PUT", "/api/annotation", EMPTY, headers)[0] == 403, origin
        assert served.ask("GET", "/api/session", None, headers)[0] == 403, origin
    own = {"Origin": f"http://127.0.0.1:{served.port}"}
    assert served.ask("GET", "/api/session", None, own)[0] == 200


def test_a_browser_that_names_another_site_is_refused(served):
    for site, wanted in (("cross-site", 403), ("same-site", 403), ("none", 200)):
        assert served.ask("GET", "/", headers={"Sec-Fetch-Site": site})[0] == wanted, site


def test_no_answer_is_for_other_pages(served):
    for path in ("/", "/api/session", "/nothing"):
        _, headers, _ = served.ask("GET", path)
        found = {key.lower(): value for key, value in headers.items()}
        policy = found["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; ")
        assert "unsafe" not in policy and "*" not in policy and "http" not in policy
        assert "frame-ancestors 'none'" in policy and "connect-src 'self'" in policy
        assert found["x-content-type-options"] == "nosniff" and found["referrer-policy"] == "no-referrer"
        assert found["cache-control"] == "no-store" and found["cross-origin-resource-policy"] == "same-origin"
        assert not [key for key in found if key.startswith("access-control")]
        assert "server" not in found


def test_large_bodies_are_refused_before_they_are_read(served):
    status, _, _ = served.ask("PUT", "/api/annotation", None, {"Content-Length": str(LARGEST_BODY + 1)})
    assert status == 413
    assert served.ask("PUT", "/api/annotation", b" " * LARGEST_BODY)[0] == 422


def test_large_bodies_without_a_length_are_refused_too(served):
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    pieces = (b" " * 100_000 for _ in range(LARGEST_BODY // 100_000 + 2))
    try:
        connection.request("PUT", "/api/annotation", pieces, {TOKEN_HEADER: served.token}, encode_chunked=True)
        assert connection.getresponse().status == 413
    except (BrokenPipeError, ConnectionResetError):
        pass  # The server hung up while the rest was being sent; the request was not answered.
    finally:
        connection.close()
    assert not served.session.draft_path.exists() and not served.session.annotation_path.exists()


def test_other_methods_are_refused(served):
    for method in ("DELETE", "PATCH", "OPTIONS", "POST", "TRACE", "HEAD"):
        for path in ("/", "/api/session", "/api/annotation", "/annotate.js"):
            assert served.ask(method, path)[0] == 405, (method, path)


CLIMBING = (
    "../../../etc/passwd",
    "rest/../rest/frontal",
    "rest/frontal.dcm",
    "push/../subject.json",
    "push/a/../../subject.json",
    "push/a/7",
    "push/b",
    "/etc/passwd",
    "rest%2ffrontal%00",
    "C:\\windows",
    "",
)


def test_no_path_comes_from_the_page(served):
    for image in CLIMBING:
        for path in ("/api/radiograph", "/api/track"):
            status, _, body = served.ask("GET", f"{path}?image={quote(image, safe='')}")
            nothing = path == "/api/track" and json.loads(body).get("state") == "none"
            assert status == 422 or nothing, (path, image)
            assert b"root:" not in body, (path, image)
        fixed = ("/../subject.json", "/%2e%2e/subject.json", "/page/index.html", "/subject.json")
        for path in (*fixed, f"/{quote(image)}x"):
            assert served.ask("GET", path)[0] == 404, (path, image)
        marks = {"vertebrae": {}, "supports": {}, "pedicles": {}, "spine": [[1, 1]]}
        saved = {"revision": served.session.revision, "draft": {"schema_version": 1, "images": {image: marks}}}
        assert served.ask("PUT", "/api/annotation", saved)[0] == 422, image
        assert not served.session.draft_path.exists(), image


NO_REQUESTS = (
    b"", b"[]", b"{", b"\xff\xfe", b'{"revision": ""}', b'{"revision": NaN, "draft": {}}', b"[" * 100_000,
    b'{"revision": "", "revision": "", "draft": {"schema_version": 1, "images": {}}}',
    b'{"revision":"", "draft": {"schema_version": 1, "images": {"rest/frontal": {"vertebrae": {"T1": [[1e400,1]]}}}}}',
    b'{"revision": "", "draft": {"schema_version": 1, "images": {"rest/frontal": {"spine": [[1e9,1]]}}}}',
)  # fmt: skip


def test_what_is_no_request_of_the_page_is_refused_in_a_line(served):
    for body in NO_REQUESTS:
        for method, path in DATA:
            if method != "GET":
                status, _, answer = served.ask(method, path, body)
                assert status == 422, (path, body[:90], answer)
                error = json.loads(answer)["error"]
                assert error and "\n" not in error and len(error) < 400, (path, body[:90])
    assert not served.session.draft_path.exists()


def test_nothing_of_the_dicom_files_text_comes_out(served):
    served.json("POST", "/api/judge", {"image": "rest/frontal", "marks": {}})
    for path in ("/", "/annotate.js", "/api/session", "/api/radiograph?image=rest/frontal", "/api/track?image=push/a"):
        _, headers, body = served.ask("GET", path)
        for word in CANARY.split("^"):
            assert word.encode() not in body and word not in str(headers)


def test_it_listens_on_loopback_alone(served):
    with listening(0) as sock:
        assert sock.getsockname()[0] == "127.0.0.1"
    from spinestiff.errors import SubjectError

    with pytest.raises(SubjectError, match=f"port {served.port} can't be used .* --port"):
        listening(served.port)
