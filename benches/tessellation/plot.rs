//! The curves as a picture: error over triangles, both logarithmic, a panel for each eye.

use crate::curves::{Curve, Method};
use crate::ground::EYES;
use crate::policy::Policy;
use crate::table::grouped;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_10X20;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, PrimitiveStyle, Rectangle, Triangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use std::convert::Infallible;
use std::path::Path;

const WIDTH: u32 = 1340;
const HEIGHT: u32 = 740;
/// Lines are drawn so many times as large and brought down, which smooths them.
const OVERSAMPLING: i32 = 3;
const PANEL: Size = Size::new(560, 500);
const PANELS_AT: [Point; 2] = [Point::new(80, 100), Point::new(745, 100)];
/// Ranges of the axes.
const TRIANGLES: [f64; 2] = [1_000.0, 4_000_000.0];
const ERROR_PX: [f64; 2] = [0.25, 32.0];

const BLACK: Rgb888 = Rgb888::new(30, 30, 30);
const FAINT: Rgb888 = Rgb888::new(225, 225, 225);

#[derive(Clone, Copy)]
enum Marker {
    Disc,
    Square,
    Peak,
}

/// Colours that the colour-blind can tell apart (Okabe and Ito), and markers for the others.
const fn look(method: Method) -> (Rgb888, Marker) {
    match method {
        Method::Policy(Policy::Uniform) => (Rgb888::new(0, 114, 178), Marker::Disc),
        Method::Policy(Policy::UniformEven) => (Rgb888::new(230, 159, 0), Marker::Disc),
        Method::Policy(Policy::Density) => (Rgb888::new(213, 94, 0), Marker::Disc),
        Method::Policy(Policy::ScreenError) => (Rgb888::new(0, 0, 0), Marker::Square),
        Method::Policy(Policy::ScreenErrorEven) => (Rgb888::new(120, 120, 120), Marker::Square),
        Method::Policy(Policy::Cdlod) => (Rgb888::new(204, 121, 167), Marker::Square),
        Method::Bintree => (Rgb888::new(86, 180, 233), Marker::Peak),
        Method::Greedy => (Rgb888::new(0, 158, 115), Marker::Peak),
    }
}

struct Canvas(RgbImage);

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            if let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y))
                && let Some(pixel) = self.0.get_pixel_mut_checked(x, y)
            {
                *pixel = Rgb([colour.r(), colour.g(), colour.b()]);
            }
        }
        Ok(())
    }
}

impl Canvas {
    fn line(&mut self, from: Point, to: Point, colour: Rgb888, width: u32) {
        let style = PrimitiveStyle::with_stroke(colour, width);
        let Ok(()) = Line::new(from, to).into_styled(style).draw(self);
    }

    fn marker(&mut self, at: Point, colour: Rgb888, marker: Marker) {
        let style = PrimitiveStyle::with_fill(colour);
        let half = 5 * OVERSAMPLING;
        let side = (2 * half) as u32;
        let low = at - Point::new(half, half);
        let Ok(()) = match marker {
            Marker::Disc => Circle::new(low, side).into_styled(style).draw(self),
            Marker::Square => Rectangle::new(low, Size::new(side, side))
                .into_styled(style)
                .draw(self),
            Marker::Peak => Triangle::new(
                Point::new(low.x, at.y + half),
                Point::new(at.x + half, at.y + half),
                Point::new(at.x, low.y),
            )
            .into_styled(style)
            .draw(self),
        };
    }

    fn text(&mut self, text: &str, at: Point, alignment: Alignment) {
        let style = TextStyleBuilder::new()
            .alignment(alignment)
            .baseline(Baseline::Middle)
            .build();
        let font = MonoTextStyle::new(&FONT_10X20, BLACK);
        let Ok(_) = Text::with_text_style(text, at, font, style).draw(self);
    }
}

/// How far `value` lies along an axis, 0 to 1.
fn along(range: [f64; 2], value: f64) -> f64 {
    (value / range[0]).ln() / (range[1] / range[0]).ln()
}

/// A point of a panel, in pixels of the large picture.
fn at(panel: Point, triangles: f64, error_px: f64) -> Point {
    let right = along(TRIANGLES, triangles) * f64::from(PANEL.width);
    let down = (1.0 - along(ERROR_PX, error_px)) * f64::from(PANEL.height);
    let scaled = |from: i32, by: f64| ((f64::from(from) + by) * f64::from(OVERSAMPLING)) as i32;
    Point::new(scaled(panel.x, right), scaled(panel.y, down))
}

/// Powers of ten, and what lies between that deserves a line.
fn triangle_ticks() -> impl Iterator<Item = (f64, bool)> {
    let decades = [1e3, 1e4, 1e5, 1e6].into_iter();
    let all =
        decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|times| (times * decade, times == 1.0)));
    all.filter(|(triangles, _)| *triangles <= TRIANGLES[1])
}

fn error_ticks() -> impl Iterator<Item = f64> {
    (-2..=5).map(|power| 2_f64.powi(power))
}

/// Draws the curves of both eyes to `path`.
pub fn plot(curves: &[Vec<Curve>; 2], path: &Path) {
    let large = OVERSAMPLING as u32;
    let white = Rgb([255, 255, 255]);
    let mut lines = Canvas(RgbImage::from_pixel(WIDTH * large, HEIGHT * large, white));
    for (panel, curves) in PANELS_AT.into_iter().zip(curves) {
        draw_panel(&mut lines, panel, curves);
    }
    let legend = legend_places();
    for (method, place) in &legend {
        let (colour, marker) = look(*method);
        let place = *place * OVERSAMPLING;
        let reach = Point::new(22 * OVERSAMPLING, 0);
        lines.line(place - reach, place + reach, colour, 3 * large);
        lines.marker(place, colour, marker);
    }
    let small = resize(&lines.0, WIDTH, HEIGHT, FilterType::Triangle);
    let mut picture = Canvas(small);
    for (panel, eye) in PANELS_AT.into_iter().zip(&EYES) {
        label_panel(&mut picture, panel, eye.name);
    }
    for (method, place) in legend {
        picture.text(method.name(), place + Point::new(34, 0), Alignment::Left);
    }
    picture
        .0
        .save(path)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// Where each method's marker stands: in two rows, each in the middle.
fn legend_places() -> Vec<(Method, Point)> {
    // Half a line, the gap to the text, the text, and the gap to the next.
    let wide = |method: &Method| 22 + 34 + 10 * method.name().len() as i32 + 16;
    let methods: Vec<Method> = Method::all().collect();
    let rows = methods.chunks(methods.len().div_ceil(2)).enumerate();
    rows.flat_map(|(row, methods)| {
        let all: i32 = methods.iter().map(wide).sum();
        let mut left = (WIDTH as i32 - all) / 2;
        let place = move |method: &Method| {
            let place = Point::new(left + 22, HEIGHT as i32 - 44 + 24 * row as i32);
            left += wide(method);
            (*method, place)
        };
        methods.iter().map(place).collect::<Vec<_>>()
    })
    .collect()
}

fn draw_panel(lines: &mut Canvas, panel: Point, curves: &[Curve]) {
    let large = OVERSAMPLING as u32;
    for (triangles, _) in triangle_ticks() {
        let [from, to] = ERROR_PX.map(|error_px| at(panel, triangles, error_px));
        lines.line(from, to, FAINT, large);
    }
    for error_px in error_ticks() {
        let [from, to] = TRIANGLES.map(|triangles| at(panel, triangles, error_px));
        lines.line(from, to, FAINT, large);
    }
    let [left, right] = TRIANGLES;
    let [bottom, top] = ERROR_PX;
    let rim = [(left, bottom), (right, bottom), (right, top), (left, top)];
    for side in 0..4 {
        let [from, to] = [rim[side], rim[(side + 1) % 4]].map(|(x, y)| at(panel, x, y));
        lines.line(from, to, BLACK, large);
    }
    for curve in curves {
        let (colour, marker) = look(curve.method);
        let points = curve
            .steps
            .iter()
            .filter(|step| (bottom..=top).contains(&step.errors.most_px))
            .map(|step| at(panel, step.triangles as f64, step.errors.most_px));
        let points: Vec<Point> = points.collect();
        for pair in points.windows(2) {
            lines.line(pair[0], pair[1], colour, 3 * large);
        }
        for &point in &points {
            lines.marker(point, colour, marker);
        }
    }
}

fn label_panel(picture: &mut Canvas, panel: Point, name: &str) {
    let middle = panel.x + PANEL.width as i32 / 2;
    picture.text(name, Point::new(middle, 30), Alignment::Center);
    let title = "error that 99.9 % of all samples stay below, px";
    let above = Point::new(panel.x - 60, panel.y - 30);
    picture.text(title, above, Alignment::Left);
    let below = panel.y + PANEL.height as i32;
    for (triangles, _) in triangle_ticks().filter(|(_, power)| *power) {
        let place = at(panel, triangles, ERROR_PX[0]) / OVERSAMPLING;
        let text = grouped(triangles as usize);
        picture.text(&text, Point::new(place.x, below + 20), Alignment::Center);
    }
    let title = Point::new(middle, below + 52);
    picture.text("triangles, all around the eye", title, Alignment::Center);
    for error_px in error_ticks() {
        let place = at(panel, TRIANGLES[0], error_px) / OVERSAMPLING;
        let place = Point::new(panel.x - 10, place.y);
        picture.text(&error_px.to_string(), place, Alignment::Right);
    }
}
