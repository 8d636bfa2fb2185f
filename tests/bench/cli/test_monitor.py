import http.client
import os
import re
import signal
import subprocess

from tests.bench.command_line import PROCESS, WIDTH, gyrobench, refusal_of
from tests.bench.monitor.served_run import served, write_snapshot


def test_it_says_where_to_look_and_how_from_the_office_and_ends_in_time(tmp_path):
    write_snapshot(tmp_path / "mine")
    ended = gyrobench("monitor", tmp_path / "mine", "--port", "0", "--for-s", "0.1", cwd=tmp_path)
    port = re.search(r"http://127\.0\.0\.1:(\d+)/", ended.stdout)[1]
    assert ended.returncode == 0
    assert f"ssh -N -L {port}:127.0.0.1:{port} " in ended.stdout


def test_it_serves_until_ctrl_c_and_then_ends_quietly(tmp_path):
    write_snapshot(tmp_path / "mine")
    command = [*PROCESS, "monitor", "mine", "--port", "0"]
    with subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | WIDTH,
    ) as monitor:
        port = re.search(r"http://127.0.0.1:(\d+)/", monitor.stdout.readline())[1]
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=30)
        connection.request("GET", "/")
        assert b"mine" in connection.getresponse().read()
        connection.close()
        monitor.send_signal(signal.SIGINT)
        _, complaints = monitor.communicate(timeout=30)
    assert (monitor.returncode, complaints) == (0, "")


def test_a_folder_that_is_not_there_is_reported(tmp_path):
    assert "nowhere: no such folder" in refusal_of("monitor", "nowhere", cwd=tmp_path)


def test_a_port_in_use_is_reported(tmp_path):
    write_snapshot(tmp_path / "mine")
    with served(tmp_path / "mine") as server:
        ended = gyrobench("monitor", "mine", "--port", server.server_port, "--for-s", "1", cwd=tmp_path)
    assert ended.returncode == 1
    assert "Choose another --port" in ended.stderr
