"""The report: tables, figures and findings as Markdown, HTML and CSV."""
