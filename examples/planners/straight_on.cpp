// A planner in C++ without a JSON library: straight on at 8 m/s, whatever is there.
//
//     c++ -O2 -o straight_on examples/planners/straight_on.cpp
//     sage simulate examples/crossing.pkl --ego 'cmd:./straight_on' --out drives/
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>

// A number of the field of the own car with this name; of a list, the one at the index.
static double number(const std::string& text, const std::string& name, int index = 0) {
    size_t at = text.find("\"" + name + "\":", text.find("\"ego\":"));
    if (at == std::string::npos) return 0.0;
    at += name.size() + 3;
    if (text[at] == '[') at++;
    for (; index > 0; index--) at = text.find(',', at) + 1;
    return std::strtod(text.c_str() + at, nullptr);
}

int main() {
    std::ios::sync_with_stdio(false);
    for (std::string line; std::getline(std::cin, line);) {
        if (line.rfind("{\"hello\"", 0) == 0) {
            std::cout << "{\"hello\":1}\n" << std::flush;
        } else if (line.rfind("{\"reset\"", 0) == 0) {
            std::cout << "{\"ready\":true}\n" << std::flush;
        } else {
            const double speed = std::hypot(number(line, "velocity", 0), number(line, "velocity", 1));
            std::cout << "{\"acceleration\":" << 0.5 * (8.0 - speed) << ",\"steering_angle\":0}\n" << std::flush;
        }
    }
}
