//! Results of tests as JUnit XML, which build servers read.

use std::fmt::Write as _;

use sage_core::text::{is_hidden, push_markup};

/// What came of a test.
pub(crate) enum Verdict {
    /// With a mark: a contact that is not shown to be the driver's fault, in words.
    Passed(Option<String>),
    /// Why it failed, in words.
    Failed(String),
    /// It failed, as it did before; why, in words.
    Accepted(String),
    /// What went wrong.
    Error(String),
}

/// A test with its result.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) seconds: f64,
    pub(crate) verdict: Verdict,
}

/// The report of a suite; `class` names what is tested.
pub(crate) fn report(suite: &str, class: &str, cases: &[Case]) -> String {
    let count = |is: fn(&Verdict) -> bool| cases.iter().filter(|case| is(&case.verdict)).count();
    let failures = count(|verdict| matches!(verdict, Verdict::Failed(_)));
    let skipped = count(|verdict| matches!(verdict, Verdict::Accepted(_)));
    let errors = count(|verdict| matches!(verdict, Verdict::Error(_)));
    let time: f64 = cases.iter().map(|case| case.seconds).sum();
    let (suite, class) = (escaped(suite), escaped(class));
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n");
    let tests = cases.len();
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "  <testsuite name=\"{suite}\" tests=\"{tests}\" failures=\"{failures}\" errors=\"{errors}\" skipped=\"{skipped}\" time=\"{time:.3}\">"
    );
    for Case { name, seconds, verdict } in cases {
        let name = escaped(name);
        let open = format!("    <testcase classname=\"{class}\" name=\"{name}\" time=\"{seconds:.3}\"");
        let _ = match verdict {
            Verdict::Passed(None) => writeln!(out, "{open}/>"),
            Verdict::Passed(Some(mark)) => {
                let mark = escaped(mark);
                writeln!(
                    out,
                    "{open}>\n      <properties>\n        <property name=\"contact\" value=\"{mark}\"/>\n      </properties>\n      <system-out>{mark}</system-out>\n    </testcase>"
                )
            }
            Verdict::Failed(why) => {
                let why = escaped(why);
                writeln!(out, "{open}>\n      <failure message=\"{why}\"/>\n    </testcase>")
            }
            Verdict::Accepted(why) => {
                let why = escaped(why);
                writeln!(
                    out,
                    "{open}>\n      <skipped message=\"failed before too: {why}\"/>\n    </testcase>"
                )
            }
            Verdict::Error(why) => {
                let why = escaped(why);
                writeln!(out, "{open}>\n      <error message=\"{why}\"/>\n    </testcase>")
            }
        };
    }
    out + "  </testsuite>\n</testsuites>\n"
}

/// Text inside an attribute: no markup, and only characters that XML 1.0 has.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\t' | '\n' | '\r' => out.push(' '),
            // Characters that XML has not, and those that are not seen or turn the direction of the text.
            c if is_hidden(c) => out.push('\u{fffd}'),
            c => push_markup(&mut out, c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_counts_and_escapes() {
        let case = |name: &str, verdict| Case { name: name.to_owned(), seconds: 0.25, verdict };
        let cases = [
            case("13-failure1", Verdict::Passed(None)),
            case("13-failure2", Verdict::Passed(Some("contact after 2.0 s, <not at fault>".to_owned()))),
            case("<script>", Verdict::Failed("hit \"it\" & died".to_owned())),
            case("known", Verdict::Accepted("hit".to_owned())),
            case("a\u{1}b\u{202e}c", Verdict::Error("no\nanswer".to_owned())),
        ];
        insta::assert_snapshot!("junit", report("suite", "cmd:python3 'p.py'", &cases));
    }
}
