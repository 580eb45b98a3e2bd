/* The practical floor of a proxy: receive a datagram, send it on, one system call each.
   Usage: forwarder LISTEN_PORT OUT_PORT (both on 127.0.0.1) */
#include <arpa/inet.h>
#include <stdlib.h>
#include <sys/socket.h>

static struct sockaddr_in at(const char *port)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(atoi(port))};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
}

int main(int count, char **words)
{
    if (count != 3)
        return 2;
    static char data[65536];
    int in = socket(AF_INET, SOCK_DGRAM, 0), out = socket(AF_INET, SOCK_DGRAM, 0), size = 4 << 20;
    struct sockaddr_in listen_at = at(words[1]), send_to = at(words[2]);
    setsockopt(in, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    setsockopt(in, SOL_SOCKET, 33 /* SO_RCVBUFFORCE */, &size, sizeof size);
    if (bind(in, (struct sockaddr *)&listen_at, sizeof listen_at))
        return 1;
    connect(out, (struct sockaddr *)&send_to, sizeof send_to);
    for (;;) {
        ssize_t length = recv(in, data, sizeof data, 0);
        if (length >= 0)
            send(out, data, length, 0);
    }
}
