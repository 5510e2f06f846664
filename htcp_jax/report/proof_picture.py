"""File with the picture of a proof, see `charts.proof_chart`."""

from pathlib import Path

from htcp_jax.proving import FileProof
from htcp_jax.report.charts.motion_proof import proof_chart
from htcp_jax.report.document import png
from htcp_jax.system import files


def draw_proof(file: Path, found: FileProof) -> None:
    """Write the picture of a proof as a PNG file.

    Raises:
        InputError: If the file cannot be written.
    """
    files.write_atomically(file.parent, file.name, png(proof_chart(found)))
