"""Where the live loop's results go: files, sockets, viewers. A sink is slow or fails alone; the loop goes on."""
