"""Texts that try to be more than text in a page, and what tests look for there."""

CRAFTED = "</script><script>window.ran=1</script><img src=x onerror=window.ran=1>\"'`${1}"
ODD = f"{CRAFTED}\u202e\0\x1b[31m\r\u2028{'W' * 10_000}"  # not in XML
HEBREW = "\u05e9\u05dc\u05d5\u05dd"
# Whether a page shows a character that is not seen.
HIDDEN = r"/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/u.test(document.body.innerText.replace(/[\n\t]/g, ''))"

HOSTILE = [
    "{{CURVES}}", "{{ curves }}", "{% raw %}", "{{ ''.__class__ }}", "</script><script>stolen()",
    "<img src=x onerror=stolen()>", "' onmouseover='stolen()", '" autofocus onfocus="stolen()',
    "a\u2028b\u2029c", "\u202egnp.exe", "<!--<script>", "javascript:stolen()", "100%", "x" * 10_000,
]  # fmt: skip
