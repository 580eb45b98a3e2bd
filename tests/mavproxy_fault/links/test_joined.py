import socket

from mavproxy_fault.links.joined import JoinedLinks
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpClient


def test_everything_is_sent_on_all_links_and_read_from_all() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for end in (one, other):
            end.bind(("127.0.0.1", 0))
            end.settimeout(10)
        links = JoinedLinks([UdpClient(*one.getsockname()), UdpClient(*other.getsockname())])
        links.write(b"hello")
        data, address = one.recvfrom(99)
        assert (data, other.recv(99)) == (b"hello", b"hello")
        one.sendto(b"reply", address)
        heard: list[tuple[int, bytes]] = []
        while not heard:
            heard = links.read()
        assert [data for _, data in heard] == [b"reply"]
        assert (links.peer_count, len(links.filenos()), links.datagrams) == (2, 2, True)
        links.close()


def test_streams_of_different_links_have_different_numbers() -> None:
    servers = [TcpServer("127.0.0.1", 0), TcpServer("127.0.0.1", 0)]
    links = JoinedLinks(servers)
    clients = [
        socket.create_connection(("127.0.0.1", int(server.name.rsplit(":", 1)[1])))
        for server in servers
    ]
    for client in clients:
        client.send(b"x")
    streams: set[int] = set()
    while len(streams) < 2:
        streams |= {stream for stream, data in links.read() if data}
    for client in clients:
        client.close()
    links.close()
    assert not links.datagrams
