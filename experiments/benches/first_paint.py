"""Time until a browser shows the first contents of a report: what a page of many failures costs whoever opens it.

    sage search scenes/ --ego idm --format none --out failures/ && sage report failures/ --out report/
    python3 experiments/benches/first_paint.py report/ [STARTS]

Starts Chromium (`CHROMIUM` names another one) some times, each with an empty profile, and prints the milliseconds of the first contentful
paint and of the load event. Exits with 1 if the median of the paints is above 500 ms.
"""

import functools
import http.server
import os
import queue
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
from urllib.parse import parse_qs, urlparse

LIMIT = 500.0
#: Seconds that a start may take.
WAIT = 60
# The policy of the page allows no request, but going to another page.
SCRIPT = b"""<script>addEventListener("load", () => setTimeout(() => {
  const paint = performance.getEntriesByName("first-contentful-paint")[0];
  const load = performance.getEntriesByType("navigation")[0];
  location = `/times?paint=${paint ? paint.startTime : -1}&load=${load.loadEventEnd}`;
}, 300))</script>"""


class Pages(http.server.SimpleHTTPRequestHandler):
    """The folder of a report, whose first page tells its times."""

    def __init__(self, *args, times, **kwargs):
        self.times = times
        super().__init__(*args, **kwargs)

    def do_GET(self):
        address = urlparse(self.path)
        if address.path == "/times":
            self.times.put({name: float(values[0]) for name, values in parse_qs(address.query).items()})
            self.send_error(404)
        elif address.path == "/":
            with open(os.path.join(self.directory, "index.html"), "rb") as file:
                text = file.read().replace(b"<head>", b"<head>" + SCRIPT, 1)
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)
        else:
            super().do_GET()

    def log_message(self, *_):
        pass


def opened(browser, address, times):
    """Milliseconds until the first contentful paint and the load event of a page."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
            f"--user-data-dir={profile}", "--remote-debugging-port=0", address,
        ]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return times.get(timeout=WAIT)
        except queue.Empty:
            raise SystemExit(f"error: {browser} told no times of {address}") from None
        finally:
            process.kill()
            process.wait()


def main(folder, starts):
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("error: Chromium is not installed; CHROMIUM names it")
    times = queue.Queue()
    pages = functools.partial(Pages, times=times, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), pages) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        found = [opened(browser, f"http://127.0.0.1:{server.server_port}/", times) for _ in range(starts)]
        server.shutdown()
    for name, of in (("first contentful paint", "paint"), ("load event", "load")):
        values = [one[of] for one in found]
        print(f"{name}: median {statistics.median(values):.0f} ms ({min(values):.0f} to {max(values):.0f}, {starts} starts)")
    return 0 <= statistics.median(one["paint"] for one in found) <= LIMIT


if __name__ == "__main__":
    sys.exit(0 if main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5) else 1)
