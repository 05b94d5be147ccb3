import pytest

from tailbeat.operator.tour import Tour


def test_a_tour_goes_on_after_an_arrival_and_after_patience():
    tour = Tour([(1.0, 0.0), (0.0, 1.0)], patience=10.0)
    for step in range(97):
        tour.see((step / 100, 0.0, 0.0), 5.0 + step / 10)
    assert tour.target == (0.0, 1.0) and tour.rows[0].reached
    assert tour.rows[0].seconds == pytest.approx(9.6)
    assert tour.rows[0].closest == pytest.approx(0.04)
    for step in range(90):
        tour.see((0.0, 0.8, 0.0), 14.7 + step / 10)
    assert len(tour.rows) == 1
    tour.see((0.0, 0.8, 0.0), 25.0)
    assert [row.reached for row in tour.rows] == [True, False]
    assert tour.rows[1].closest == pytest.approx(0.2)
    tour.see((0.0, 1.0, 0.0), 26.0)
    assert len(tour.rows) == 2
