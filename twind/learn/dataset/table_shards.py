"""Tables in files of bounded size: chunk-000/file-000.parquet and so on, as LeRobot numbers them."""

from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

NAME = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


class ShardLocation(NamedTuple):
    """Place of one file."""

    chunk: int
    file: int


class ShardWriter:
    """Rows are appended; the next file begins before one would grow beyond its size, its index aside.

    `close` it, or nothing of it can be read.
    """

    def __init__(self, folder: Path, schema: pa.Schema, *, size: int, chunk: int) -> None:
        """`size` in bytes of a file, `chunk` in files of a folder."""
        self._folder = folder
        self._schema = schema
        self._size = size
        self._chunk = chunk
        self._place = ShardLocation(0, 0)
        self._writer: Any = None
        self._file: Any = None
        self._rows = 0

    def place(self, rows: int) -> ShardLocation:
        """Return the file for the next `rows` rows."""
        if self._writer is not None and self._rows:
            each = self._file.tell() / self._rows
            if self._file.tell() + each * rows >= self._size:
                self.close()
                chunk, file = self._place
                self._place = (
                    ShardLocation(chunk + 1, 0) if file + 1 == self._chunk else ShardLocation(chunk, file + 1)
                )
        return self._place

    def append(self, table: pa.Table) -> None:
        """Rows that belong together, into the file that `place` named: one row group. Raises OSError."""
        if self._writer is None:
            self._open()
        self._writer.write_table(table, row_group_size=max(1, table.num_rows))
        self._rows += table.num_rows

    def close(self) -> None:
        """Finish the file that is open. Raises OSError."""
        if self._writer is not None:
            self._writer.close()
            self._file.close()
        self._writer = self._file = None
        self._rows = 0

    def _open(self) -> None:
        path = self._folder / NAME.format(chunk_index=self._place.chunk, file_index=self._place.file)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = pa.OSFile(str(path), "wb")
        self._writer = pq.ParquetWriter(self._file, self._schema, compression="snappy")
