import os
import socket
import struct

import pytest

from gyrobench.drivers.served_ports import PseudoTerminal, TcpListener, TcpPort


def test_a_link_that_a_killed_program_left_is_replaced(tmp_path):
    link = tmp_path / "table"
    link.symlink_to("/dev/pts/999999")
    port = PseudoTerminal(link)
    assert link.resolve().is_char_device()
    port.unplug()
    assert not link.is_symlink()


def test_a_link_that_leads_somewhere_and_a_file_are_kept(tmp_path):
    for name, target in (("link", tmp_path), ("file", None)):
        path = tmp_path / name
        path.symlink_to(target) if target else path.write_text("mine")
        with pytest.raises(FileExistsError):
            PseudoTerminal(path)
        assert path.exists()


def test_what_a_client_writes_is_read_and_the_other_way(tmp_path):
    port = PseudoTerminal(tmp_path / "port")
    client = os.open(port.url, os.O_RDWR | os.O_NOCTTY)
    os.write(client, b"ask\r\n")
    assert port.read() == b"ask\r\n"
    assert port.read() == b""
    assert port.write(b"reply") == 5
    assert os.read(client, 10) == b"reply"
    os.close(client)
    port.unplug()


def test_a_port_number_in_use_is_an_error():
    first = TcpPort()
    with pytest.raises(OSError, match="in use"):
        TcpPort(first.number)
    first.unplug()
    second = TcpPort(first.number)
    assert second.url == first.url
    second.unplug()


def test_a_new_client_is_greeted():
    port = TcpListener()
    with socket.create_connection(("127.0.0.1", port.number), timeout=120) as client:
        accepted = port.accept(b"< hi >")
        assert client.recv(100) == b"< hi >"
        accepted.unplug()
    assert port.accept() is None
    port.unplug()


def test_a_second_client_is_disconnected_and_the_first_stays():
    port = TcpPort()
    with socket.create_connection(("127.0.0.1", port.number), timeout=120) as first:
        first.sendall(b"a")
        assert port.read() == b"a"
        with socket.create_connection(("127.0.0.1", port.number), timeout=120) as second:
            assert port.read() == b""
            assert second.recv(100) == b""
        port.write(b"still yours")
        assert first.recv(100) == b"still yours"
        first.sendall(b"b")
        assert port.read() == b"b"
    with socket.create_connection(("127.0.0.1", port.number), timeout=120) as after:
        after.sendall(b"c")
        assert b"c" in (port.read(), port.read())
    port.unplug()


def test_a_client_found_gone_while_it_is_written_to_leaves_the_port_to_the_next():
    port = TcpPort()
    gone = socket.create_connection(("127.0.0.1", port.number), timeout=120)
    port.read()
    # A linger of zero makes the kernel reset the connection.
    gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    gone.close()
    assert port.write(b"frame") == 5
    assert port.fileno() >= 0
    with socket.create_connection(("127.0.0.1", port.number), timeout=120) as client:
        client.sendall(b"V\r")
        assert b"V\r" in (port.read(), port.read())
    port.unplug()
