"""Pointers that Git LFS leaves in place of files until they are downloaded."""

LFS_HEAD = b"version https://git-lfs.github.com/spec/"
LFS_FAULT = "is a pointer of Git LFS, not the file: run 'git lfs pull' in its repository"


def is_lfs_pointer(data: bytes) -> bool:
    """Whether a file is such a pointer."""
    return data.startswith(LFS_HEAD)
