//! Self-contained HTML reports with plots of palpate recordings.
