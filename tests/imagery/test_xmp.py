"""XMP packets of photographs: positions, attitudes and standard deviations, beside the EXIF data."""

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from jaxbundle.imagery.exif import Station
from jaxbundle.imagery.xmp import XmpData, station_of, xmp_data, xmp_of

PACKET = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:AbsoluteAltitude="+198.52"
 drone-dji:GpsLatitude="46.8426071" drone-dji:GpsLongtitude="-91.9945599" drone-dji:GimbalYawDegree="+45.10"
 drone-dji:GimbalPitchDegree="-89.90" drone-dji:GimbalRollDegree="+0.00"
 drone-dji:RtkStdLon="0.011" drone-dji:RtkStdLat="0.012" drone-dji:RtkStdHgt="0.025"/>
</rdf:RDF></x:xmpmeta>"""


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_packet_of_a_drone(suffix, tmp_path):
    path, image, text = tmp_path / f"a.{suffix}", Image.new("L", (40, 30)), PngInfo()
    text.add_itxt("XML:com.adobe.xmp", PACKET)
    own = {"jpg": {"xmp": PACKET.encode()}, "png": {"pnginfo": text}, "tif": {"tiffinfo": {700: PACKET.encode()}}}
    image.save(path, **own[suffix])
    found = xmp_of(path)
    assert found.station == Station(46.8426071, -91.9945599, 198.52)
    assert found.attitude == (45.1, -89.9, 0.0)
    assert found.sigmas == (0.011, 0.012, 0.025)


def test_elements_and_other_names():
    found = xmp_data("<Camera:Yaw>12</Camera:Yaw><Camera:Pitch>-80.5</Camera:Pitch> <Camera:GPSXYAccuracy>2.5</C>")
    assert found.station is None and found.attitude is None
    np.testing.assert_array_equal(found.sigmas, [2.5, 2.5, np.nan])


def test_position_of_both(tmp_path):
    there = XmpData(Station(46.8, -91.9, 198.5))
    assert station_of(None, there) == there.station
    assert station_of(Station(46.7, -91.8, 190.0), there) == Station(46.7, -91.8, 190.0)
    assert station_of(Station(46.7, -91.8, np.nan), there) == Station(46.7, -91.8, 198.5)
    assert xmp_data(PACKET.replace("46.8426071", "0").replace("-91.9945599", "0.0")).station is None
    (tmp_path / "text.jpg").write_text("no image")
    assert xmp_of(tmp_path / "text.jpg").station is None
