"""Image pyramids: pixel by pixel those of GDAL and Pillow where their rule is ours, written once, read by windows."""

import os

import numpy as np
import pytest
import rasterio
import tifffile
from PIL import Image
from rasterio.enums import Resampling

import jaxbundle as jb
from jaxbundle.imagery.levels import between_levels, grey, halved, level_sizes
from jaxbundle.imagery.pyramid_file import pyramid

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def beach(shared_data):
    """Part of a real photograph whose sides are multiples of 32."""
    return np.asarray(Image.open(shared_data / "images" / "brighton" / "DJI_0018.jpg").convert("L"))[:1024, :1984]


def overviews_of_gdal(image, path, factors):
    rows, columns = image.shape
    with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype=image.dtype) as file:
        file.write(image, 1)
    with rasterio.open(path, "r+") as file:
        file.build_overviews(factors, Resampling.average)
    levels = []
    for k in range(len(factors)):
        with rasterio.open(path, overview_level=k) as file:
            levels.append(file.read(1))
    return levels


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_levels_equal_those_of_gdal(beach, bits, tmp_path):
    image = beach if bits == 8 else (beach.astype(np.uint16) * 257 + np.arange(1984, dtype=np.uint16)) >> (16 - bits)
    for level in overviews_of_gdal(image, tmp_path / "image.tif", [2, 4, 8, 16, 32]):
        image = halved(image)
        np.testing.assert_array_equal(image, level)


@pytest.mark.parametrize("size", [(513, 641), (8, 7), (1, 5), (2, 2)])
def test_odd_sizes_equal_pillow(size):
    image = np.random.default_rng(1).integers(0, 256, size, np.uint8)
    np.testing.assert_array_equal(halved(image), np.asarray(Image.fromarray(image).reduce(2)))


@pytest.mark.thorough
def test_aerial_photograph_of_odd_levels(shared_data, tmp_path):
    path = shared_data / "images" / "strasbourg" / "8937.jpg"
    made = pyramid(path, tmp_path)
    assert made.sizes[:5] == ((12996, 8858), (6498, 4429), (3249, 2215), (1625, 1108), (813, 554))
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        image = Image.open(path)
        image.load()
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    for level in range(1, len(made.sizes)):
        image = image.reduce(2)
        np.testing.assert_array_equal(made.level(level), np.asarray(image))


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_gdal_reads_the_file(beach, compression, tmp_path):
    Image.fromarray(beach).save(tmp_path / "beach.png")
    made = pyramid(tmp_path / "beach.png", compression=compression)
    with rasterio.open(made.path) as file:
        assert file.overviews(1) == [2, 4, 8]
        np.testing.assert_array_equal(file.read(1), beach)
    for k in range(3):
        with rasterio.open(made.path, overview_level=k) as file:
            np.testing.assert_array_equal(file.read(1), made.level(k + 1))


def test_means_of_levels_stay():
    image = np.random.default_rng(2).integers(0, 4096, (512, 768), np.uint16)
    mean, exact = image.mean(), image.astype(np.float32)
    for level in range(1, 5):
        image, exact = halved(image), halved(exact)
        assert exact.mean(dtype=float) == pytest.approx(mean, rel=1e-6)
        assert 0 < image.mean() - mean < level / 8 + 0.05  # rounding half up; 0.05: chance


def test_noise_halves_from_level_to_level():
    image = np.random.default_rng(3).standard_normal((2048, 2048)).astype(np.float32)
    for level in range(1, 4):
        image = halved(image)
        assert image.std() == pytest.approx(0.5**level, rel=0.03)


def test_coordinates_between_levels():
    assert between_levels(np.array([0.5, 7.0]), 0, 3).tolist() == [0.0625, 0.875]
    assert between_levels(0.25, 2, 0) == 1.0
    assert level_sizes(256, 100) == ((256, 100),)


@pytest.mark.parametrize("shape", [(300, 517), (300, 517, 3)])
@pytest.mark.parametrize("layout", ["strips", "tiles", "rows"])
def test_tiff_by_segments(shape, layout, tmp_path):
    image = np.random.default_rng(4).integers(0, 65536, shape, np.uint16)
    options = {"strips": {"rowsperstrip": 37}, "tiles": {"tile": (64, 48)}, "rows": {"rowsperstrip": 300}}[layout]
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "a.tif", image, photometric=photometric, compression="zlib", **options)
    made = jb.imagery.pyramid(tmp_path / "a.tif", tmp_path / "out")
    np.testing.assert_array_equal(made.level(0), image)
    np.testing.assert_array_equal(made.level(1), halved(image))
    np.testing.assert_array_equal(made.window(0, (250, 250), (50, 267)), image[250:, 250:])
    assert grey(image).shape == shape[:2]


def test_found_again_by_size_time_and_hash(beach, tmp_path):
    source = tmp_path / "beach.png"
    Image.fromarray(beach[:300, :300]).save(source)
    made = pyramid(source)
    written = made.path.stat().st_mtime_ns
    assert pyramid(source) == made
    os.utime(source, (1, 1))  # another time, the same pixels
    assert pyramid(source) == made
    assert made.path.stat().st_mtime_ns == written
    changed = bytearray(source.read_bytes())
    Image.fromarray(beach[1:301, :300]).save(source)
    assert source.read_bytes() != changed
    np.testing.assert_array_equal(pyramid(source).level(0), beach[1:301, :300])


def test_windows_outside_are_refused(beach, tmp_path):
    Image.fromarray(beach[:300, :300]).save(tmp_path / "beach.png")
    made = pyramid(tmp_path / "beach.png")
    with pytest.raises(ValueError, match="exceed level 1 of beach.png, which has 150 rows"):
        made.window(1, (100, 0), (51, 10))
    with pytest.raises(ValueError, match="levels 0 to 1, not 2"):
        made.level(2)


def test_files_that_are_not_images(shared_data, tmp_path):
    whole = (shared_data / "images" / "brighton" / "DJI_0018.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[:200_000])
    (tmp_path / "text.jpg").write_text("no image")
    for name in ("cut.jpg", "text.jpg"):
        with pytest.raises(jb.imagery.ImageError, match=f"{name}: is not a readable image"):
            pyramid(tmp_path / name)
        assert not (tmp_path / "pyramids" / f"{name}.tif").exists()


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_headers_of_photographs(name, tmp_path):
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(tmp_path / name)
    photo = jb.imagery.photograph(tmp_path / name)
    assert (photo.rows, photo.columns, photo.channels) == photo.shape == (20, 30, 3)
    (tmp_path / name).write_text("no image", encoding="utf-8")
    with pytest.raises(jb.imagery.ImageError, match="is not a readable image"):
        jb.imagery.photograph(tmp_path / name)
