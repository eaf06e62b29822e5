/* The parts of the page as C strings, which the Makefile generates from the files beside it. */
#pragma once

extern const char spin_html_head[], spin_html_css[], spin_html_body[], spin_html_project[],
    spin_html_vertex[], spin_html_fragment[], spin_html_worker[], spin_html_script[];
