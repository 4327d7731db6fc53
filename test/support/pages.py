"""What every page must be: one file that loads nothing and runs no script but its own."""

from __future__ import annotations

import base64
import hashlib
import re
import xml.etree.ElementTree as ET

XHTML = "{http://www.w3.org/1999/xhtml}"
LOADING = ("link", "iframe", "object", "embed", "img", "use")


def assert_self_contained(text: str, links: tuple[str, ...] = ()) -> None:
    """Check that a page, which is also XML, has nothing to load, and that its policy allows its one script only.

    It links to places in itself and to `links`.
    """
    root = ET.fromstring(text)
    for element in root.iter():
        assert element.tag.split("}")[-1] not in LOADING
        for name, value in element.attrib.items():
            assert name.split("}")[-1] not in ("src", "srcset", "data", "action") and not name.startswith("on")
            assert not name.endswith("href") or value.startswith("#") or value in links
    assert not re.search(r"url\((?!#)|@import|@font-face", text)
    assert set(re.findall(r"\b(\w+)=.https?:", text)) <= {"xmlns"}
    scripts = [s for s in root.iter(f"{XHTML}script") if s.get("type") != "application/json"]
    source = text.rsplit("<script>", 1)[1].split("</script>", 1)[0]
    digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
    policy = next(m.get("content", "") for m in root.iter(f"{XHTML}meta") if m.get("http-equiv"))
    assert len(scripts) == 1
    assert policy.startswith("default-src 'none'") and policy.endswith(f"script-src 'sha256-{digest}'")
