"""Middlewares of HTTP: those that count and tell see what the others refuse, and what caches answer."""

from prometheus_client.parser import text_string_to_metric_families

TOKEN = "correct-horse.battery~staple"
OWN = {"Sec-Fetch-Site": "same-origin"}


def counted(mapper):
    """How many requests were answered so, by route, method and class of status."""
    return {
        (sample.labels["route"], sample.labels["method"], sample.labels["status"]): sample.value
        for family in text_string_to_metric_families(mapper.http.get("/metrics").text)
        for sample in family.samples
        if sample.name == "ogm_http_requests_total"
    }


def test_what_is_refused_and_what_is_sent_again_is_counted_and_told(start_mapper, caplog):
    with start_mapper(http={"token": TOKEN}) as mapper:
        mapper.draw_cross()
        foreign = mapper.http.get("/map.png", headers={"Host": "evil.example"})
        page = mapper.http.post("/reset", headers={"Sec-Fetch-Site": "cross-site"})
        guess = mapper.http.post("/reset", headers={"Authorization": "Bearer x", **OWN})
        assert [answer.status_code for answer in (foreign, page, guess)] == [421, 403, 401]
        again = [mapper.http.get("/map.png", params={"t": k}) for k in range(3)]
        assert len({answer.content for answer in again}) == 1
        seen = counted(mapper)
    assert seen["/map.png", "GET", "4xx"] == 1
    assert seen["/reset", "POST", "4xx"] == 2
    assert seen["/map.png", "GET", "2xx"] == 3
    told = [record.getMessage() for record in caplog.records if "refused over HTTP" in record.getMessage()]
    assert [any(f"({status};" in line for line in told) for status in (421, 403, 401)] == [True] * 3
