"""Sheets to print at true size: fish tag, target tag, calibration board. Draws only."""

from pathlib import Path
from typing import Any

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tailbeat.files import BadInput, new_file, refuse_existing
from tailbeat.fish.proportions import LARGEST_TAG
from tailbeat.vision.tags import BLACK, FAMILY, MODULES, Board, board_picture, tag_picture

A4 = (210.0, 297.0)  # mm
INCH = 25.4
DPI = 300
FORMATS = (".pdf", ".svg", ".png")


def write_sheets(out: Path, ids: tuple[int, int], side: float, board: Board) -> list[Path]:
    """Write fish tag, target tag and board, each on an A4 page: one PDF, or three SVG or PNG files.
    `side` [m] of the tags' black squares. Raises BadInput."""
    if out.suffix not in FORMATS:
        raise BadInput(f"{out}: give a name that ends in {', '.join(FORMATS)}.")
    if not 10 <= 1e3 * side <= LARGEST_TAG:
        raise BadInput(f"--side {side:g}: give 0.01 to {1e-3 * LARGEST_TAG:g} m; a page is A4.")
    size = board.square * board.columns, board.square * board.rows
    if not (0.002 <= board.square and size[0] <= 0.28 and size[1] <= 0.19):
        raise BadInput(f"--square {board.square:g}: the board would be {size} m; a page is A4.")
    pages = {
        "fish": tag_page("fish", ids[0], 1e3 * side),
        "target": tag_page("target", ids[1], 1e3 * side),
        "board": board_page(board),
    }
    if out.suffix == ".pdf":
        with new_file(out) as beside:
            _as_pdf(beside, list(pages.values()))
        return [out]
    paths = {name: out.with_stem(f"{out.stem}-{name}") for name in pages}
    for path in paths.values():
        refuse_existing(path)
    for name, page in pages.items():
        with new_file(paths[name]) as beside:
            page.savefig(beside, dpi=DPI)
    return list(paths.values())


def _as_pdf(path: Path, pages: list[Figure]) -> None:
    with PdfPages(path) as file:
        for page in pages:
            file.savefig(page)


def _page(size: tuple[float, float]) -> tuple[Figure, Any]:
    """A page whose axes are millimetres from its left bottom corner."""
    page = Figure(figsize=(size[0] / INCH, size[1] / INCH))
    axes = page.add_axes((0, 0, 1, 1), xlim=(0, size[0]), ylim=(0, size[1]))
    axes.set_axis_off()
    return page, axes


def tag_page(name: str, ident: int, side: float) -> Figure:
    """A tag, `side` [mm] of its black square, with the arrow that points to the fish's nose."""
    page, axes = _page(A4)
    module = side / BLACK
    left, bottom = A4[0] / 2 - MODULES * module / 2, 110.0
    for row, cells in enumerate(tag_picture(ident)):
        for column, cell in enumerate(cells):
            place = left + column * module, bottom + (MODULES - 1 - row) * module
            if not cell:
                axes.add_patch(Rectangle(place, module, module, color="black", lw=0, aa=False))
    whole = MODULES * module
    axes.add_patch(Rectangle((left, bottom), whole, whole, fill=False, ec="0.7", lw=0.3, ls="--"))
    middle = bottom - 12
    axes.annotate("", (left + whole, middle), (left, middle),
                  arrowprops={"arrowstyle": "-|>", "lw": 2, "color": "black"})  # fmt: skip
    aim = "towards the nose" if name == "fish" else "any direction"
    axes.text(A4[0] / 2, middle - 8, f"{name}, {aim}", ha="center", fontsize=14)
    words = (
        f"{FAMILY}, id {ident}; black square {side:g} mm: print at 100 %, measure it, and give the"
        f" side to calibrate.\nCut along the dashed line: keep the white border. Use matt paper,"
        f" stiff and flat; no glossy paper or lamination."
    )
    axes.text(A4[0] / 2, middle - 22, words, ha="center", va="top", fontsize=8)
    _ruler(axes, A4[0] / 2 - 50, 40)
    return page


def board_page(board: Board) -> Figure:
    """The ChArUco board on a landscape page."""
    page, axes = _page(A4[::-1])
    across, down = 1e3 * board.square * board.columns, 1e3 * board.square * board.rows
    left, bottom = (A4[1] - across) / 2, (A4[0] - down) / 2 + 7
    picture, edges = board_picture(board, 160), (left, left + across, bottom, bottom + down)
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255, extent=edges, interpolation="none")
    axes.set(xlim=(0, A4[1]), ylim=(0, A4[0]), aspect="auto")
    words = (
        f"ChArUco {board.columns} x {board.rows}, DICT_5X5_100, squares {1e3 * board.square:g} mm,"
        f" markers {1e3 * board.marker:g} mm; print at 100 %, glue it to a flat board."
    )
    axes.text(left, 12, words, fontsize=8)
    _ruler(axes, A4[1] - 125, 5)
    return page


def _ruler(axes: Any, x: float, y: float) -> None:
    """A ruler of 100 mm, to check that the printer did not scale."""
    axes.plot([x, x + 100], [y, y], color="black", lw=0.8)
    for at in range(0, 101, 10):
        axes.plot([x + at, x + at], [y, y + 2], color="black", lw=0.8)
    axes.text(x + 102, y, "100 mm", fontsize=8, va="center")
