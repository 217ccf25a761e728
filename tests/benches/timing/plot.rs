//! Line plots as SVG, in colours that differ on white and on black.

use std::fmt::Write as _;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 30.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 50.0;
/// Okabe and Ito's palette.
const COLOURS: [&str; 6] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];

/// Range and marks of an axis.
pub struct Axis {
    pub label: &'static str,
    pub from: f64,
    pub to: f64,
    pub logarithmic: bool,
    pub marks: Vec<f64>,
}

impl Axis {
    /// Position of a value on the axis, 0 to 1, limited to its ends.
    fn place(&self, value: f64) -> f64 {
        let scale = |value: f64| if self.logarithmic { value.log10() } else { value };
        let value = value.clamp(self.from, self.to);
        (scale(value) - scale(self.from)) / (scale(self.to) - scale(self.from))
    }
}

/// A plot. Each line has a name and its points.
pub struct Plot {
    pub title: &'static str,
    pub x: Axis,
    pub y: Axis,
    pub lines: Vec<(&'static str, Vec<(f64, f64)>)>,
    /// Distance of the line names from the top, to place them where no line is.
    pub names_down: f64,
}

impl Plot {
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (across, up) = (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
        (LEFT + across * self.x.place(x), HEIGHT - BOTTOM - up * self.y.place(y))
    }

    /// The plot as an SVG file.
    pub fn svg(&self) -> String {
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"{WIDTH}\" \
             height=\"{HEIGHT}\" fill=\"white\"/>\n"
        );
        let mut text = |x: f64, y: f64, anchor: &str, more: &str, text: &str| {
            _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{text}</text>"
            );
        };
        text(WIDTH / 2.0, 22.0, "middle", " font-size=\"15\"", self.title);
        text(WIDTH / 2.0, HEIGHT - 12.0, "middle", "", self.x.label);
        let turned = format!(" transform=\"rotate(-90 16 {0})\"", HEIGHT / 2.0);
        text(16.0, HEIGHT / 2.0, "middle", &turned, self.y.label);
        for &mark in &self.x.marks {
            text(
                self.at((mark, self.y.from)).0,
                HEIGHT - BOTTOM + 16.0,
                "middle",
                "",
                &mark.to_string(),
            );
        }
        for &mark in &self.y.marks {
            text(LEFT - 6.0, self.at((self.x.from, mark)).1 + 4.0, "end", "", &mark.to_string());
        }
        for (n, (name, _)) in self.lines.iter().enumerate() {
            let colour = format!(" fill=\"{}\"", COLOURS[n % COLOURS.len()]);
            text(
                LEFT + 8.0,
                TOP + self.names_down + 18.0 + 16.0 * n as f64,
                "start",
                &colour,
                name,
            );
        }
        let mut line = |points: &[(f64, f64)], stroke: &str, width: f64| {
            let points =
                points.iter().map(|&point| self.at(point)).map(|(x, y)| format!("{x:.1} {y:.1}"));
            let path = points.collect::<Vec<_>>().join("L");
            _ = writeln!(
                svg,
                "<path d=\"M{path}\" fill=\"none\" stroke=\"{stroke}\" stroke-width=\"{width}\"/>"
            );
        };
        for &mark in &self.x.marks {
            line(&[(mark, self.y.from), (mark, self.y.to)], "#ddd", 1.0);
        }
        for &mark in &self.y.marks {
            line(&[(self.x.from, mark), (self.x.to, mark)], "#ddd", 1.0);
        }
        for (n, (_, points)) in self.lines.iter().enumerate() {
            line(points, COLOURS[n % COLOURS.len()], 2.0);
        }
        svg.push_str("</svg>\n");
        svg
    }
}
