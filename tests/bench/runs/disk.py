"""What a disk holds if the power fails: kept up from the calls of fsync that a program makes."""

import os
from pathlib import Path


class Disk:
    """Watches ``os.fsync`` for everything below a folder; that folder itself is on the disk."""

    def __init__(self, root):
        self.root = Path(root)
        #: Every state in which a power cut or a kill would have left the folder: file name to content.
        self.states = {}
        self._contents = {}
        self._names = {}
        self._held = []
        self._sync = os.fsync

    def close(self):
        for descriptor in self._held:
            os.close(descriptor)

    def fsync(self, descriptor):
        """Takes the place of ``os.fsync``."""
        self.fail_here()
        self._sync(descriptor)
        path = Path(f"/proc/self/fd/{descriptor}").resolve()
        if path.is_relative_to(self.root):
            self._held.append(os.dup(descriptor))  # or the number of a file would be given to another
            inode = os.fstat(descriptor).st_ino
            if path.is_dir():
                self._names[inode] = self._listing(path)
            else:
                self._contents[inode] = path.read_bytes()
        self.fail_here()

    def fail_here(self):
        """Keep what would be there if it all ended now."""
        for state in (
            self.synced(),
            self._state(self._names_now, self._content_synced),
            self._state(self._names_now, self._content_now),
        ):
            self.states.setdefault(frozenset(state.items()), state)

    def synced(self):
        """What is there after a power cut, by what was synced and nothing else."""
        return self._state(lambda path, inode: self._names.get(inode, {}), self._content_synced)

    def _state(self, names, content):
        files, folders = {}, [(self.root, self.root.stat().st_ino, "")]
        while folders:
            path, inode, place = folders.pop()
            for name, (number, is_folder) in names(path, inode).items():
                if is_folder:
                    folders.append((path / name, number, f"{place}{name}/"))
                else:
                    files[place + name] = content(path / name, number)
        return files

    def _names_now(self, path, inode):
        return self._listing(path)

    def _content_now(self, path, inode):
        return path.read_bytes()

    def _content_synced(self, path, inode):
        return self._contents.get(inode, b"")

    def _listing(self, path):
        return {entry.name: (entry.inode(), entry.is_dir()) for entry in os.scandir(path)}


def lay_out(state, folder):
    """Write a state into a new folder."""
    for name, content in state.items():
        path = Path(folder) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
